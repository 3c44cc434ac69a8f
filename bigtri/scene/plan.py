"""Effects: what a scene calls for, decided once, so that what it does not need is never run."""

from __future__ import annotations

from dataclasses import dataclass

from .scene import Scene


@dataclass(frozen=True)
class RenderPlan:
    """Which effects ``render`` runs. One that is False costs nothing: its attributes are not even interpolated.

    A scene says per material which effects apply, so running one that no material calls for changes no bit: ``EVERYTHING`` and
    ``plan_for(scene)`` give the same picture. Leaving out one that a material does call for leaves it out of the picture.

    Culling is not here. It decides what is drawn, not how: at the silhouette of a closed surface a back face may win a pixel over
    the front face that it meets there, so that culling can change a bit. ``Scene.cull`` asks for it.

    Attributes:
        textures: textures are looked up.
        vertex_colors: vertex colours are interpolated.
        smooth_normals: vertex normals are interpolated.
        flat_normals: triangles' own normals are used.
        two_sided: normals of back faces are turned round.
        lights: there are lights beyond the ambient one. Without them no normal is needed.
    """

    textures: bool = True
    vertex_colors: bool = True
    smooth_normals: bool = True
    flat_normals: bool = True
    two_sided: bool = True
    lights: bool = True

    def __str__(self) -> str:
        names = [name.replace("_", " ") for name, on in vars(self).items() if on]
        return ", ".join(names) or "no effects"


EVERYTHING = RenderPlan()


def plan_for(scene: Scene) -> RenderPlan:
    """The effects that materials in use and lights call for, and no other."""
    used = [scene.materials[m] for m in scene.used_materials]
    lights = len(scene.lights) > 0
    smooth = [m.smooth and scene.normals is not None for m in used]
    return RenderPlan(
        textures=scene.uvs is not None and any(m.texture is not None for m in used),
        vertex_colors=scene.colors is not None and any(m.vertex_colors for m in used),
        smooth_normals=lights and any(smooth),
        flat_normals=lights and not all(smooth),
        two_sided=lights and any(m.two_sided for m in used),
        lights=lights,
    )
