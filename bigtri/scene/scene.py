"""What is drawn: geometry, materials and lights as plain arrays. ``load_scene`` makes one from a file."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from ..choices import CULLS
from ..ops.texture import FILTERS, WRAPS
from .camera import Camera
from .carried import Lamp, Marks
from .checks import check_array, check_choice
from .origin import WORLD_ORIGIN, bounds_of, relative
from .readers.transforms import mirrors, placed, turned
from .vectors import Vector, number, numbers, vector

if TYPE_CHECKING:
    from .plan import Plan
    from .tensors import SceneTensors

ALPHA_MODES = ("opaque", "mask", "blend")


@dataclass(frozen=True, eq=False)
class Material:
    """How a surface looks. Its colour is base_color * texture * interpolated vertex colour, as far as it has them.

    Attributes:
        name: for people.
        base_color: linear red, green, blue.
        texture: [Ht, Wt, 3], row 0 on top, the channels last, or None: float32, linear; or uint8 or uint16, sRGB codes, which
            are kept and decoded only where they are read.
        wrap, filter: how the texture is read: "repeat" or "clamp", "bilinear" or "nearest".
        vertex_colors: whether the scene's vertex colours apply.
        smooth: whether normals are interpolated from the vertices; otherwise each triangle is flat.
        two_sided: whether a back face is lit as if its normal pointed at the viewer. Open surfaces need it.
        alpha_mode: "opaque", "mask" or "blend": what alpha is for. This and all below is carried for files, and not drawn yet.
        alpha: of the whole surface. That of a texture is not kept.
        alpha_cutoff: below which alpha the surface is not there, if it is masked.
        unlit: whether its colour is shown without lights.
        emissive: linear red, green, blue that it emits.
        emissive_texture: as ``texture``, times ``emissive``; or None.

    Raises:
        TypeError, ValueError: an attribute that is not as said above; the text names it.
    """

    name: str = "material"
    base_color: Vector = (1.0, 1.0, 1.0)
    texture: NDArray[np.float32] | NDArray[np.uint8] | NDArray[np.uint16] | None = None
    wrap: str = "repeat"
    filter: str = "bilinear"
    vertex_colors: bool = False
    smooth: bool = True
    two_sided: bool = True
    alpha_mode: str = "opaque"
    alpha: float = 1.0
    alpha_cutoff: float = 0.5
    unlit: bool = False
    emissive: Vector = (0.0, 0.0, 0.0)
    emissive_texture: NDArray[np.float32] | NDArray[np.uint8] | NDArray[np.uint16] | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.name, str):
            raise TypeError(f"bigtri.Material: name must be text, got {self.name!r}")
        object.__setattr__(self, "base_color", vector("Material", "base_color", self.base_color))
        self._keep_texture("texture")
        self._keep_texture("emissive_texture")
        check_choice("Material", "wrap", self.wrap, WRAPS)
        check_choice("Material", "filter", self.filter, FILTERS)
        check_choice("Material", "alpha_mode", self.alpha_mode, ALPHA_MODES)
        object.__setattr__(self, "emissive", vector("Material", "emissive", self.emissive))
        for name in ("alpha", "alpha_cutoff"):
            object.__setattr__(self, name, number("Material", name, getattr(self, name)))
        for name in ("vertex_colors", "smooth", "two_sided", "unlit"):
            if not isinstance(getattr(self, name), bool | np.bool_):
                raise TypeError(f"bigtri.Material: {name} must be True or False, got {getattr(self, name)!r}")

    def _keep_texture(self, name: str) -> None:
        given = getattr(self, name)
        if given is None:
            return
        shape: tuple[int, ...] = given.shape if isinstance(given, np.ndarray) else ()
        if len(shape) == 3 and shape[0] in (1, 3, 4) and shape[2] not in (1, 3, 4):
            raise ValueError(
                f"bigtri.Material: {name} must be [Ht, Wt, 3], got {list(shape)}, "
                f"which looks like [C, Ht, Wt]: pass {name}.transpose(1, 2, 0)"
            )
        texture = check_array("Material", name, given, (np.float32, np.uint8, np.uint16), "Ht", "Wt", 3)
        if texture.size == 0:
            raise ValueError(f"bigtri.Material: {name} must have at least one texel, got {list(texture.shape)}")
        object.__setattr__(self, name, texture)


@dataclass(frozen=True)
class Light:
    """Light from infinitely far away.

    Attributes:
        direction: towards the light, world space; made a unit vector.
        color: linear red, green, blue.

    Raises:
        TypeError, ValueError: an attribute that is not three finite numbers, or a direction of no length.
    """

    direction: Vector
    color: Vector = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        x, y, z = vector("Light", "direction", self.direction)
        object.__setattr__(self, "color", vector("Light", "color", self.color))
        length = math.sqrt((x * x + y * y) + z * z)
        if not 0 < length < math.inf:
            raise ValueError(f"bigtri.Light: direction must be finite and not zero, got {self.direction}")
        object.__setattr__(self, "direction", (x / length, y / length, z / length))


# A warm key from above the camera's right shoulder and a cool fill from the other side: with the ambient light they stay below
# white on a white surface, so that nothing saturates.
DEFAULT_LIGHTS = (Light((0.5, 0.9, 0.7), (0.72, 0.69, 0.63)), Light((-0.8, 0.25, -0.35), (0.16, 0.19, 0.24)))
DEFAULT_AMBIENT: Vector = (0.16, 0.17, 0.19)
DEFAULT_BACKGROUND = ((0.52, 0.62, 0.76), (0.86, 0.88, 0.90))


# What a scene may have for each of its vertices, and how many numbers of it.
_OF_VERTICES = {"normals": 3, "uvs": 2, "colors": 3}


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything to be drawn, in world space. Arrays are NumPy.

    Attributes:
        positions: float32 [V, 3], counted from ``origin``.
        triangles: int32 [T, 3]; counter-clockwise from the front.
        normals: float32 [V, 3], or None: everything is flat.
        uvs: float32 [V, 2], (0, 0) at the lower left of the texture, or None: nothing is textured.
        colors: float32 [V, 3], linear, or None.
        material: int32 [T], indices into ``materials``.
        materials: at least one.
        lights: any number of them; without any the ambient light is all there is.
        ambient: linear red, green, blue.
        background: linear colours at the top and at the bottom of the picture, blended in between; or one for both.
        cull: "none", "back" or "front": which faces are not drawn.
        origin: where in world space positions are counted from, in float64. Cameras and ``bounds`` know nothing of it: it is
            there to keep positions small, since float32 has no millimetres of map coordinates in the millions.
        marks: points and lines of a file, any number of sets. This and all below is carried, and not drawn yet.
        cameras: those of a file: ``render`` takes them, but does so only if it is given them.
        lamps: the lights of a file.
        instance: int32 [T], which object each triangle belongs to, from 0, or None: all belong to object 0. ``merge`` numbers the
            objects of its scenes one after the other, and readers those of a file; ``instance_ids`` finds them in a picture.

    Raises:
        TypeError, ValueError: arrays that do not belong together; the text names the attribute.
    """

    positions: NDArray[np.float32]
    triangles: NDArray[np.int32]
    normals: NDArray[np.float32] | None = None
    uvs: NDArray[np.float32] | None = None
    colors: NDArray[np.float32] | None = None
    material: NDArray[np.int32] = field(default=None)  # type: ignore[arg-type]
    materials: tuple[Material, ...] = (Material(),)
    lights: tuple[Light, ...] = DEFAULT_LIGHTS
    ambient: Vector = DEFAULT_AMBIENT
    background: tuple[Vector, Vector] = DEFAULT_BACKGROUND
    cull: str = "none"
    origin: Vector = WORLD_ORIGIN
    marks: tuple[Marks, ...] = ()
    cameras: tuple[Camera, ...] = ()
    lamps: tuple[Lamp, ...] = ()
    instance: NDArray[np.int32] | None = None

    def __post_init__(self) -> None:
        self._keep_array("positions", np.float32, "V", 3)
        self._keep_array("triangles", np.int32, "T", 3)
        vertices, faces = len(self.positions), len(self.triangles)
        for name, channels in _OF_VERTICES.items():
            if getattr(self, name) is not None:
                self._keep_array(name, np.float32, vertices, channels)
        if self.material is None:
            object.__setattr__(self, "material", np.zeros(faces, np.int32))
        self._keep_array("material", np.int32, faces)
        if self.instance is not None:
            self._keep_array("instance", np.int32, faces)
            if faces and self.instance.min() < 0:
                raise ValueError(f"bigtri.Scene: instance must be at least 0, got {self.instance.min()}")
        object.__setattr__(self, "materials", _all_of("materials", self.materials, Material))
        object.__setattr__(self, "lights", _all_of("lights", self.lights, Light))
        if not self.materials:
            raise ValueError("bigtri.Scene: materials must hold at least one Material, got none")
        object.__setattr__(self, "ambient", vector("Scene", "ambient", self.ambient))
        object.__setattr__(self, "background", background_of("Scene", self.background))
        for name, count, of in (("material", len(self.materials), "materials"), ("triangles", vertices, "positions")):
            indices = getattr(self, name)
            if faces and not (indices.min() >= 0 and indices.max() < count):
                got = f"indices from {indices.min()} to {indices.max()}"
                raise ValueError(f"bigtri.Scene: {name} must index the {count} {of}, got {got}")
        check_choice("Scene", "cull", self.cull, CULLS)
        object.__setattr__(self, "origin", vector("Scene", "origin", self.origin))
        for name, kind in (("marks", Marks), ("cameras", Camera), ("lamps", Lamp)):
            object.__setattr__(self, name, _all_of(name, getattr(self, name), kind))

    def _keep_array(self, name: str, dtype: type[np.generic], *shape: int | str) -> None:
        object.__setattr__(self, name, check_array("Scene", name, getattr(self, name), (dtype,), *shape))

    @property
    def bounds(self) -> NDArray[np.float64]:
        """float64 [2, 3], world space: the lowest and highest corner of what the triangles use; of an empty scene the origin."""
        used = np.zeros(len(self.positions), bool)
        used[self.triangles.reshape(-1)] = True
        bounds = bounds_of(self.positions[used])
        if bounds is None:
            bounds = np.zeros((2, 3))
        return bounds if self.origin == WORLD_ORIGIN else bounds + np.array(self.origin)  # -0 + 0 would be another zero

    @property
    def points(self) -> NDArray[np.float64]:
        """float64 [N, 3], world space: the vertices that the triangles use, which ``Camera.tight_framing`` takes."""
        used = np.zeros(len(self.positions), bool)
        used[self.triangles.reshape(-1)] = True
        return self.positions[used].astype(np.float64) + np.array(self.origin)

    @property
    def instance_count(self) -> int:
        """How many numbers objects may have: one more than the highest in ``instance``."""
        return 1 if self.instance is None else int(self.instance.max(initial=0)) + 1

    @property
    def used_materials(self) -> tuple[int, ...]:
        """The materials that a triangle has, rising."""
        return tuple(np.flatnonzero(np.bincount(self.material, minlength=1)).tolist())

    def on(self, device: str | torch.device) -> SceneTensors:
        """The scene as tensors on a device, "cpu" or "cuda", which ``render`` takes too: what is drawn often is uploaded once.

        On the CPU the tensors share the arrays' memory.
        """
        from .tensors import SceneTensors

        return SceneTensors(self, torch.device(device))

    def plan(
        self,
        camera: Camera | None = None,
        resolution: tuple[int, int] | None = None,
        *,
        on: Iterable[str] = (),
        off: Iterable[str] = (),
        approximate: bool = False,
    ) -> Plan:
        """Which effects the scene calls for, each with the fact that calls for it or rules it out; ``print`` shows a table.

        Nothing is drawn, and nothing waits for a GPU: it reads the scene's own arrays.

        Args:
            camera: if given, the plan also says what its triangles need as this camera sees them: perspective, clipping.
            resolution: (height, width) of the picture, px; 720 x 1280 where it is left out.
            on: effects to run whether they are called for or not, which changes no bit: attributes of ``RenderPlan``.
            off: effects to leave out.
            approximate: whether ``off`` may hold what the scene calls for. The plan then says that the picture is another.

        Raises:
            ValueError: an unknown effect, one that is in both, or one in ``off`` that the scene calls for.
        """
        from .plan import explain

        return explain(self, camera, resolution, on=on, off=off, approximate=approximate)

    def with_(self, **changes: Any) -> Scene:
        """A copy with other attributes."""
        return replace(self, **changes)

    # A point beyond float32's range becomes an infinity, and rasterize drops and counts its triangles.
    @np.errstate(over="ignore", invalid="ignore")
    def moved(self, matrix: ArrayLike) -> Scene:
        """The scene at another pose: ``merge([a.moved(A), b.moved(B)])`` puts several together.

        Positions and marks go by the matrix, normals by its inverse transpose, in float64, and the origin is chosen anew, as
        ``load_scene`` chooses it. A matrix that mirrors turns triangles round, so that their fronts stay fronts. Lights, and the
        cameras and lamps of files, stay where they are.

        Args:
            matrix: [4, 4], from world space to world space, affine, for column vectors.

        Raises:
            TypeError, ValueError: something else.
        """
        affine = numbers("Scene.moved", "matrix", matrix)
        if affine.shape != (4, 4):
            raise ValueError(f"bigtri.Scene.moved: matrix must be [4, 4], got {list(affine.shape)}")
        if not (np.isfinite(affine).all() and affine[3].tolist() == [0, 0, 0, 1]):
            raise ValueError(f"bigtri.Scene.moved: matrix must be finite with a last row of 0 0 0 1, got {affine.tolist()}")
        origin, (positions,) = relative([placed(affine, self.positions.astype(np.float64) + np.array(self.origin))])
        return replace(
            self,
            positions=positions,
            triangles=self.triangles[:, ::-1] if mirrors(affine) else self.triangles,
            normals=None if self.normals is None else turned(affine, self.normals),
            origin=origin,
            marks=tuple(marks.placed(affine, self.origin, origin) for marks in self.marks),
        )


def merge(scenes: Sequence[Scene]) -> Scene:
    """One scene with the geometry, materials, marks, cameras and lamps of all. Lights, ambient light, background and culling are
    the first one's. Instances are numbered one after the other: those of the first scene keep their numbers, those of the second
    follow, a scene without numbers being one instance.

    Where all have the same origin, positions stay as they are. Otherwise they are brought together in float64, and the origin is
    chosen anew, as ``load_scene`` chooses it.

    Raises:
        TypeError: something that is no Scene.
        ValueError: no scene at all.
    """
    if wrong := [type(scene).__name__ for scene in scenes if not isinstance(scene, Scene)]:
        raise TypeError(f"bigtri.merge: scenes must hold Scene alone, got {', '.join(wrong)}")
    if not scenes:
        raise ValueError("bigtri.merge: scenes must hold at least one scene, got none")
    vertex_offset = np.cumsum([0] + [len(s.positions) for s in scenes])
    instance_offset = np.cumsum([0] + [s.instance_count for s in scenes])
    materials: dict[int, int] = {}  # a material that several scenes share is kept once: identity to index
    kept: list[Material] = []
    indices = []
    for scene in scenes:
        own = [_without_missing(material, scene) for material in scene.materials]
        for material in own:
            if materials.setdefault(id(material), len(kept)) == len(kept):
                kept.append(material)
        indices.append(np.array([materials[id(material)] for material in own], np.int32)[scene.material])
    joined: dict[str, Any] = {}
    for name, channels in _OF_VERTICES.items():
        given = [getattr(s, name) for s in scenes]
        # Materials without the effect never read the zeros that stand in for it.
        zeros = (np.zeros((len(s.positions), channels), np.float32) for s in scenes)
        parts = [zero if array is None else array for array, zero in zip(given, zeros, strict=True)]
        joined[name] = None if all(array is None for array in given) else np.concatenate(parts)
    origin, positions = scenes[0].origin, [s.positions for s in scenes]
    if any(s.origin != origin for s in scenes):
        origin, positions = relative([s.positions.astype(np.float64) + np.array(s.origin) for s in scenes])
    return replace(
        scenes[0],
        positions=np.concatenate(positions),
        triangles=np.concatenate([s.triangles + np.int32(o) for s, o in zip(scenes, vertex_offset, strict=False)]),
        material=np.concatenate(indices),
        materials=tuple(kept),
        origin=origin,
        marks=tuple(marks.counted_from(s.origin, origin) for s in scenes for marks in s.marks),
        cameras=tuple(camera for s in scenes for camera in s.cameras),
        lamps=tuple(lamp for s in scenes for lamp in s.lamps),
        instance=np.concatenate([_instances_from(int(first), s) for first, s in zip(instance_offset, scenes, strict=False)]),
        **joined,
    )


def _instances_from(first: int, scene: Scene) -> NDArray[np.int32]:
    """int32 [T]: a scene's instances, counted from ``first``."""
    return np.full(len(scene.triangles), first, np.int32) if scene.instance is None else scene.instance + np.int32(first)


def _without_missing(material: Material, scene: Scene) -> Material:
    """The material less the effects for which its scene has no data; the very same where there is nothing to leave out."""
    missing: dict[str, Any] = {}
    if material.texture is not None and scene.uvs is None:
        missing["texture"] = None
    if material.vertex_colors and scene.colors is None:
        missing["vertex_colors"] = False
    if material.smooth and scene.normals is None:
        missing["smooth"] = False
    return replace(material, **missing) if missing else material


def _all_of(name: str, value: Any, kind: type) -> tuple[Any, ...]:
    """A scene's materials or lights as a tuple."""
    try:
        items = tuple(value)
    except TypeError:
        raise TypeError(f"bigtri.Scene: {name} must be a sequence of {kind.__name__}, got {value!r}") from None
    if wrong := [item for item in items if not isinstance(item, kind)]:
        raise TypeError(f"bigtri.Scene: {name} must be a sequence of {kind.__name__}, got {wrong[0]!r} in it")
    return items


def background_of(owner: str, value: Any) -> tuple[Vector, Vector]:
    """Two linear colours, at the top and at the bottom, of one for both or of two. ``owner`` is for the error text.

    Raises:
        TypeError, ValueError: neither.
    """
    wanted = f"bigtri.{owner}: background must be a colour, or two, at the top and at the bottom, got {value!r}"
    try:
        colors = tuple(value)
    except TypeError:
        raise TypeError(wanted) from None
    if len(colors) == 3:
        one = vector(owner, "background", colors)
        return one, one
    if len(colors) != 2:
        raise ValueError(wanted)
    return vector(owner, "background", colors[0]), vector(owner, "background", colors[1])
