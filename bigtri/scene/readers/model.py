"""What a model file holds, in the same terms for every format."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..camera import Camera
from ..carried import Lamp
from ..vectors import Vector


class ModelError(ValueError):
    """A file, or a part of it, that cannot be drawn. The text says where, what came and what is allowed, in one line."""


class ModelWarning(UserWarning):
    """A model file holds something that its picture does not show."""


@dataclass(frozen=True)
class Finding:
    """Something that a file holds and the picture cannot show.

    Attributes:
        kind: a few words that name it, the same for every place where it is found, such as "points" or "alpha blending".
        text: one sentence for people: what was found, what is drawn instead.
        count: how many places have it.
    """

    kind: str
    text: str
    count: int = 1


@dataclass(frozen=True, eq=False)
class Paint:
    """A material as the file has it.

    Attributes:
        name: for people; "" if the file gives none.
        base_color: linear red, green, blue; None where the file says nothing about colour.
        texture: sRGB codes, uint8 or uint16 [Ht, Wt, 3], row 0 on top, or None. One image used twice is one array.
        wrap: "repeat" or "clamp".
        filter: "bilinear" or "nearest".
        double_sided: whether the file asks for both faces to be lit; None where the format cannot say.
        alpha_mode, alpha, alpha_cutoff, unlit, emissive: as in ``Material``.
        emissive_texture: codes as those of ``texture``, at the same texture coordinates.
    """

    name: str = ""
    base_color: Vector | None = None
    texture: NDArray[Any] | None = None
    wrap: str = "repeat"
    filter: str = "bilinear"
    double_sided: bool | None = None
    alpha_mode: str = "opaque"
    alpha: float = 1.0
    alpha_cutoff: float = 0.5
    unlit: bool = False
    emissive: Vector = (0.0, 0.0, 0.0)
    emissive_texture: NDArray[Any] | None = None


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles of one paint, with the attributes that the file gives them.

    Attributes:
        name: for people.
        positions: float32 or float64 [V, 3], in the mesh's own space. Meshes may share arrays.
        triangles: int32 [T, 3], indices into the positions, counter-clockwise from the front.
        normals: float32 or float64 [V, 3] of any length, or None.
        uvs: float32 [V, 2], (0, 0) at the lower left of the texture, or None.
        colors: float32 [V, 3], linear; [T, 3] if ``colors_of_faces``; or None.
        colors_of_faces: whether a colour belongs to a triangle instead of a vertex.
        paint: the material, or None.
        transforms: float64 [N, 4, 4], one for each place where the mesh is drawn, column vectors.
        instances: int32 [N], or [N, T]: the number, within the file, of the object that each place, or each triangle of it,
            belongs to; None: of object 0.
    """

    name: str
    positions: NDArray[Any]
    triangles: NDArray[np.int32]
    normals: NDArray[Any] | None = None
    uvs: NDArray[np.float32] | None = None
    colors: NDArray[np.float32] | None = None
    colors_of_faces: bool = False
    paint: Paint | None = None
    transforms: NDArray[np.float64] = field(default_factory=lambda: np.eye(4)[None])
    instances: NDArray[np.int32] | None = None


@dataclass(frozen=True, eq=False)
class Strokes:
    """Points or line segments of one paint. Attributes as in ``Mesh``, and

    Attributes:
        indices: int32 [N, 1] of points, [N, 2] of line segments.
    """

    positions: NDArray[Any]
    indices: NDArray[np.int32]
    colors: NDArray[np.float32] | None = None
    paint: Paint | None = None
    transforms: NDArray[np.float64] = field(default_factory=lambda: np.eye(4)[None])


@dataclass
class Model:
    """All that was read of a file.

    Attributes:
        meshes: in the order of the file.
        strokes: its points and lines.
        cameras, lamps: in world space.
        findings: what is not drawn, once per kind.
    """

    meshes: list[Mesh] = field(default_factory=list)
    findings: dict[str, Finding] = field(default_factory=dict)
    strokes: list[Strokes] = field(default_factory=list)
    cameras: list[Camera] = field(default_factory=list)
    lamps: list[Lamp] = field(default_factory=list)

    def found(self, kind: str, text: str) -> None:
        """Notes something that will not be drawn; the first text of a kind is kept, and the places are counted."""
        known = self.findings.get(kind)
        self.findings[kind] = Finding(kind, known.text if known else text, known.count + 1 if known else 1)
