"""What the benchmarks of pictures draw: the real scenes with lights, normals and textures, the demo, and model files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from bigtri import Camera, Material, Scene, load_scene, rasterize
from bigtri.ops import shade as pictures
from bigtri.precision import RUNGS, Arithmetic
from bigtri.reference.shade import Surface
from bigtri.scene.normals import split_normals
from bigtri.scene.plan import RenderPlan
from bigtri.study import courtyard, meshes
from bigtri.study.scenes import REAL

SEED = 0
# One colour, which OpenGL can clear with, as bigtri fills it.
BACKGROUND = (0.2, 0.3, 0.4)
LOOKS = ("lit", "textured")
DEFAULT = ("R16k-lit", "R16k-textured", "R100k-textured", "Rterrain-textured", "Rroom-lit", "Rcourtyard")


class Pictured(NamedTuple):
    """A scene and who looks at it."""

    name: str
    scene: Scene
    camera: Callable[[float], Camera]  # of the picture's width / height


def make(name: str) -> Pictured:
    """A scene by name: "Rcourtyard", the name of another real scene with one of ``LOOKS``, or a model file's path.

    Raises:
        ValueError: none of these.
    """
    if name == "Rcourtyard":
        return Pictured(name, demo(), lambda aspect: courtyard.camera())
    recipe_name, _, look = name.rpartition("-")
    if recipe_name in REAL and look in LOOKS:
        recipe = REAL[recipe_name]
        mesh = meshes.of(recipe, SEED)
        return Pictured(name, dressed(mesh, look), lambda aspect: meshes.CAMERAS[recipe.camera](mesh, aspect))
    if not Path(name).is_file():
        raise ValueError(f"no scene and no file {name!r}; scenes are Rcourtyard and a real one's name with {' or '.join(LOOKS)}")
    scene = load_scene(name)
    return Pictured(Path(name).stem, on_one_colour(scene), lambda aspect: Camera.framing(scene.bounds, aspect=aspect))


def on_one_colour(scene: Scene) -> Scene:
    return scene.with_(background=(BACKGROUND, BACKGROUND))


@lru_cache(maxsize=1)
def demo() -> Scene:
    return on_one_colour(courtyard.courtyard())


def dressed(mesh: meshes.Mesh, look: str) -> Scene:
    """A mesh with the default lights and vertex normals; "textured" also with a texture, laid on from the side."""
    positions = mesh.vertices.astype(np.float32)
    source, triangles, normals = split_normals(positions, mesh.triangles)
    low, high = mesh.bounds()
    x, y, z = ((mesh.vertices[source] - low) / (high - low).max()).T
    uvs = np.stack([2 * (x + z), 2 * (y + 0.3 * z)], axis=1).astype(np.float32)
    texture = painted(1024) if look == "textured" else None
    scene = Scene(positions[source], triangles, normals, uvs, materials=(Material(look, (0.8, 0.7, 0.6), texture),))
    return on_one_colour(scene)


@lru_cache(maxsize=1)
def painted(side: int) -> NDArray[np.uint8]:
    """uint8 [side, side, 3], sRGB codes: soft waves of every length, and squares."""
    rng = np.random.default_rng(SEED)
    y, x = np.mgrid[0:side, 0:side] * (2 * np.pi / side)
    image = np.full((side, side, 3), 0.5)
    for octave in range(7):
        a, b = rng.integers(1, 4, 2) * 2**octave
        phases = rng.uniform(0, 2 * np.pi, 3)
        image += 0.25 / 1.5**octave * np.sin((a * x + b * y)[..., None] + phases)
    squares = ((x // (np.pi / 8) + y // (np.pi / 8)) % 2)[..., None]
    return np.clip(255 * (0.75 * image + 0.2 * squares), 0, 255).astype(np.uint8)


class Target(NamedTuple):
    """What is drawn, on one device, and memory for it. No call waits or takes memory that is kept, so graphs can hold them."""

    positions: torch.Tensor  # float32 [B, V, 4]
    triangles: torch.Tensor  # int32 [T, 3]
    surface: Surface[torch.Tensor]
    packed: torch.Tensor  # int64 [B, samples * H, samples * W]
    image: torch.Tensor  # uint8 [B, H, W, 3]
    samples: int
    arithmetic: Arithmetic
    fills: bool

    def draw(self) -> None:
        nothing = pictures.Made()
        given = self.positions, self.triangles, "none", self.surface, self.image, self.samples
        pictures.draw(*given, nothing, None, self.arithmetic, "native", fills=self.fills)

    def shade(self) -> None:
        nothing = pictures.Made()
        given = self.packed, self.positions, self.triangles, self.surface, self.image
        pictures.shade(*given, nothing, self.arithmetic, "native")

    def rasterize(self) -> None:
        (_, height, width), precision = self.packed.shape, self.arithmetic.precision
        rasterize(self.positions, self.triangles, (height, width), depth=False, out=self.packed, precision=precision)


def target(
    scene: Scene,
    cameras: Sequence[Camera],
    resolution: tuple[int, int],
    plan: RenderPlan,
    samples: int,
    precision: str,
    device: torch.device,
) -> Target:
    """A scene as its cameras see it, ready to be drawn."""
    (height, width), views, tensors = resolution, len(cameras), scene.on(device)
    clip = np.stack([camera.transform(scene.positions, width / height, scene.origin) for camera in cameras])
    matrices = np.stack([camera.matrix(width / height, scene.origin) for camera in cameras])
    shape = views, height * samples, width * samples
    return Target(
        torch.from_numpy(clip).to(device),
        tensors.triangles,
        tensors.surface(plan, scene.background),
        torch.empty(shape, dtype=torch.int64, device=device),
        torch.empty((views, height, width, 3), dtype=torch.uint8, device=device),
        samples,
        RUNGS[precision],
        tensors.fills_picture(matrices),
    )
