"""From a scene to pictures: shading, and views that explain one. Not called `render`, which is the function `bigtri.render`."""
