"""A ``Model`` as a ``Scene``: everything placed in world space, with normals and materials."""

from __future__ import annotations

from collections import Counter
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..camera import Camera
from ..carried import Marks
from ..normals import is_closed, smooth_normals, split_normals, weld
from ..origin import WORLD_ORIGIN, joined, origin_for
from ..scene import Material, Scene, merge
from ..vectors import Vector
from .model import Mesh, Model, ModelError, Paint, Strokes
from .transforms import bounds_of_placed, mirrors, placed_from, turned

# For geometry that says nothing about its colour: linear, a light grey.
_GREY: Vector = (0.6, 0.6, 0.6)
_WHITE: Vector = (1.0, 1.0, 1.0)
_MOST = 2**31 - 1  # int32 counts vertices and triangles


# A point beyond float32's range becomes an infinity, and rasterize drops and counts its triangles.
@np.errstate(over="ignore", invalid="ignore")
def assemble(model: Model) -> Scene:
    """The scene of a model: every mesh at every place.

    Vertex normals are computed where the model has none, with a crease of 50 degrees. Surfaces that do not enclose a solid,
    or that the model calls double-sided, are lit from both sides. Meshes with the same vertices in the same place share
    them, and an image is one array however many materials have it.

    Raises:
        ModelError: there are no triangles, or more than int32 counts.
    """
    meshes = [mesh for mesh in model.meshes if len(mesh.triangles) and len(mesh.transforms)]
    if not meshes:
        others = f"; found: {', '.join(model.findings)}" if model.findings else ""
        raise ModelError(f"there are no triangles in it: point clouds and lines are not drawn{others}")
    if (count := sum(len(mesh.triangles) * len(mesh.transforms) for mesh in meshes)) > _MOST:
        raise ModelError(f"there must be at most {_MOST} triangles in it, got {count}")
    groups = [list(group) for _, group in groupby(meshes, _shared_vertices)]
    places = Counter(id(group[0].positions) for group in groups for _ in group[0].transforms)
    # What a vertex array has for others is left out.
    batches = [_Batch(group, only_used=places[id(group[0].positions)] > 1) for group in groups]
    placed = [(batch, place) for batch in batches for place in range(len(batch.transforms))]
    boxes = (bounds_of_placed(batch.transforms[place], batch.positions) for batch, place in placed)
    bounds = joined([box for box in boxes if box is not None])
    origin = WORLD_ORIGIN if bounds is None else origin_for(bounds)
    materials = _Materials(model)
    parts = [batch.at(place, origin, materials, model) for batch, place in placed]
    for part in parts:
        if part.uvs is not None and not np.isfinite(part.uvs).all():
            model.found("texture coordinates beyond float32", "texture coordinates are not finite: 0 is taken for them")
        if not np.isfinite(part.positions).all():
            model.found("positions beyond float32", "positions are not finite, or beyond float32: their triangles are not drawn")
    # merge would number the parts, of which an object may have several.
    instance = [batch.instances(place) for batch, place in placed] if any(m.instances is not None for m in meshes) else None
    scene = parts[0] if len(parts) == 1 else merge(parts)
    scene = scene.with_(instance=None if instance is None else np.concatenate(instance))
    marks = [_marks(strokes, transform, origin) for strokes in model.strokes for transform in strokes.transforms]
    cameras = [_with_planes(camera, scene) for camera in model.cameras]
    return scene.with_(marks=marks, cameras=cameras, lamps=model.lamps)


def _with_planes(camera: Camera, scene: Scene) -> Camera:
    """The camera with the near and far planes that the file does not give it, chosen by the scene, if it sees any of it."""
    try:
        return camera.fitted(scene.bounds)
    except ValueError:
        return camera


def _marks(strokes: Strokes, transform: NDArray[np.float64], origin: Vector) -> Marks:
    kept, (indices,) = _used([strokes.indices], len(strokes.positions))
    colors = None if strokes.colors is None else strokes.colors[kept]
    base = None if strokes.paint is None else strokes.paint.base_color
    return Marks(placed_from(origin, transform, strokes.positions[kept]), indices, colors, base or _WHITE)


def _shared_vertices(mesh: Mesh) -> tuple[Any, ...]:
    """Equal for meshes that can share vertices, arrays and places being the same."""
    if mesh.normals is None or mesh.colors_of_faces:
        return (id(mesh),)  # they get vertices of their own
    return (*(id(array) for array in (mesh.positions, mesh.normals, mesh.uvs, mesh.colors)), mesh.transforms.tobytes())


class _Batch:
    """Meshes that share vertices, or a single one. Attributes as in ``Mesh``, but of the vertices that are kept."""

    def __init__(self, meshes: list[Mesh], only_used: bool) -> None:
        first = meshes[0]
        self.transforms = first.transforms
        self._meshes = meshes
        self._triangles = [mesh.triangles for mesh in meshes]
        normals = None if first.colors_of_faces else first.normals
        kept: Any = slice(None)
        # To make normals, vertices are copied anyway.
        if only_used or normals is None:
            kept, self._triangles = _used(self._triangles, len(first.positions))
        self.positions = first.positions[kept]
        self._normals = None if normals is None else normals[kept]
        self._uvs = None if first.uvs is None else first.uvs[kept]
        self._colors = first.colors
        if first.colors is not None and not first.colors_of_faces:
            self._colors = first.colors[kept]

    def instances(self, place: int) -> NDArray[np.int32]:
        """int32 [T]: the objects that the triangles at one place belong to."""
        parts = [
            np.broadcast_to(np.int32(0) if mesh.instances is None else mesh.instances[place], len(mesh.triangles))
            for mesh in self._meshes
        ]
        return np.concatenate(parts)

    def at(self, place: int, origin: Vector, materials: _Materials, model: Model) -> Scene:
        """The meshes at one place, counted from the origin; ``model`` gets as findings what they lack."""
        transform = self.transforms[place]
        positions = placed_from(origin, transform, self.positions)
        triangles = self._triangles
        # A mirrored mesh would show its back faces.
        if mirrors(transform):
            triangles = [np.ascontiguousarray(some[:, ::-1]) for some in triangles]
        welded = weld(positions)
        closed = [is_closed(positions, some, welded) for some in triangles]
        looks = [materials.of(mesh, two_sided=not solid) for mesh, solid in zip(self._meshes, closed, strict=True)]
        number = {id(look): i for i, look in enumerate(dict.fromkeys(looks))}
        material = np.repeat(np.array([number[id(look)] for look in looks], np.int32), [len(some) for some in triangles])
        joined_triangles = triangles[0] if len(triangles) == 1 else np.concatenate(triangles)
        uvs, colors = self._uvs, self._colors
        if self._meshes[0].colors_of_faces and colors is not None:
            # Faces of different colours share no vertex.
            corners = joined_triangles.reshape(-1)
            positions, welded, uvs = positions[corners], welded[corners], None if uvs is None else uvs[corners]
            colors = np.repeat(colors, 3, axis=0)
            joined_triangles = np.arange(len(corners), dtype=np.int32).reshape(-1, 3)
        if self._normals is not None:
            normals = _with_a_direction(turned(transform, self._normals), positions, joined_triangles, welded, model)
        else:
            source, joined_triangles, normals = split_normals(positions, joined_triangles, place=welded)
            positions, uvs = positions[source], None if uvs is None else uvs[source]
            colors = None if colors is None else colors[source]
        return Scene(positions, joined_triangles, normals, uvs, colors, material, tuple(dict.fromkeys(looks)), origin=origin)


def _used(triangles: list[NDArray[np.int32]], count: int) -> tuple[Any, list[NDArray[np.int32]]]:
    """Which of ``count`` vertices the triangles use, and the triangles over these alone, their order kept."""
    used = np.zeros(count, bool)
    for some in triangles:
        used[some] = True
    if used.all():
        return slice(None), triangles
    number = np.cumsum(used, dtype=np.int32) - np.int32(1)
    return used, [number[some] for some in triangles]


def _with_a_direction(
    normals: NDArray[np.float32],
    positions: NDArray[np.float32],
    triangles: NDArray[np.int32],
    place: NDArray[np.int32],
    model: Model,
) -> NDArray[np.float32]:
    """Unit normals [V, 3] of a file; those that have no length, or are not finite, from the triangles around them."""
    lost = ~(np.einsum("ij,ij->i", normals, normals) > 0.5)
    if not lost.any():
        return normals
    computed = smooth_normals(positions, triangles, place)
    # Where no triangle has an area, nothing is drawn that would miss them.
    if count := np.count_nonzero((computed[lost] != 0).any(axis=1)):
        model.found("normals without a direction", f"{count} normals have no direction: those of the surface are taken for them")
    return np.where(lost[:, None], computed, normals)


class _Materials:
    """Makes materials; meshes of one paint and look get the same."""

    def __init__(self, model: Model) -> None:
        """``model`` gets as findings what meshes lack for their paint."""
        self._model = model
        self._known: dict[tuple[Any, ...], Material] = {}

    def of(self, mesh: Mesh, two_sided: bool) -> Material:
        paint = mesh.paint or Paint()
        two_sided = two_sided or bool(paint.double_sided)
        colored, textured = mesh.colors is not None, paint.texture is not None and mesh.uvs is not None
        # Without a paint there is only the mesh's name to tell materials apart by.
        key = (mesh.name if mesh.paint is None else id(paint), two_sided, colored, textured)
        if key not in self._known:
            base = paint.base_color or (_WHITE if colored or textured else _GREY)
            texture = paint.texture if textured else None
            if paint.texture is not None and not textured:
                text = f"the material {paint.name or 'without a name'} has a texture, but a mesh of it has no coordinates for it"
                self._model.found("textures without coordinates", f"{text}: it is drawn without the texture")
            self._known[key] = Material(
                paint.name or mesh.name,
                base,
                texture,
                paint.wrap,
                paint.filter,
                colored,
                two_sided=two_sided,
                alpha_mode=paint.alpha_mode,
                alpha=paint.alpha,
                alpha_cutoff=paint.alpha_cutoff,
                unlit=paint.unlit,
                emissive=paint.emissive,
                emissive_texture=paint.emissive_texture if mesh.uvs is not None else None,
            )
        return self._known[key]
