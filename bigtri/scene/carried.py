"""What a model file holds that ``render`` does not draw yet. A scene carries it for those who have a use for it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .checks import check_array, check_choice
from .readers.transforms import placed_from
from .vectors import Vector, number, vector

LAMP_KINDS = ("directional", "point", "spot")


@dataclass(frozen=True, eq=False)
class Marks:
    """Points or line segments.

    Attributes:
        positions: float32 [V, 3], counted from the scene's origin.
        indices: int32 [N, 1] of points, [N, 2] of line segments.
        colors: float32 [V, 3], linear, or None.
        base_color: linear red, green, blue, which colors are multiplied by.

    Raises:
        TypeError, ValueError: an attribute that is not as said above; the text names it.
    """

    positions: NDArray[np.float32]
    indices: NDArray[np.int32]
    colors: NDArray[np.float32] | None = None
    base_color: Vector = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "positions", check_array("Marks", "positions", self.positions, (np.float32,), "V", 3))
        object.__setattr__(self, "indices", check_array("Marks", "indices", self.indices, (np.int32,), "N", "1 or 2"))
        count = len(self.positions)
        if self.indices.shape[1] not in (1, 2):
            raise ValueError(f"bigtri.Marks: indices must be int32 [N, 1] or [N, 2], got {list(self.indices.shape)}")
        if self.indices.size and not (self.indices.min() >= 0 and self.indices.max() < count):
            got = f"indices from {self.indices.min()} to {self.indices.max()}"
            raise ValueError(f"bigtri.Marks: indices must index the {count} positions, got {got}")
        if self.colors is not None:
            object.__setattr__(self, "colors", check_array("Marks", "colors", self.colors, (np.float32,), count, 3))
        object.__setattr__(self, "base_color", vector("Marks", "base_color", self.base_color))

    def counted_from(self, origin: Vector, to: Vector) -> Marks:
        """The same place, counted from another origin."""
        if origin == to:
            return self
        step = np.array(origin) - np.array(to)
        return replace(self, positions=(self.positions.astype(np.float64) + step).astype(np.float32))

    def placed(self, matrix: NDArray[np.float64], origin: Vector, to: Vector) -> Marks:
        """By a matrix [4, 4] of world space, counted from another origin."""
        return replace(self, positions=placed_from(to, matrix, self.positions.astype(np.float64) + np.array(origin)))


@dataclass(frozen=True)
class Lamp:
    """A light of a file, unlike ``Light`` with a place and a unit.

    Attributes:
        kind: "directional", "point" or "spot".
        position: world space; of no meaning if it is directional.
        direction: in which it shines; of no meaning if it is a point.
        color: linear red, green, blue.
        intensity: lux (lm/m^2) if it is directional, else candela (lm/sr).
        range: the distance beyond which it has no effect, or None.
        cone: of a spot, the angles from its direction where it begins to fall off and where it ends, degrees.

    Raises:
        TypeError, ValueError: an attribute that is not as said above; the text names it.
    """

    kind: str
    position: Vector = (0.0, 0.0, 0.0)
    direction: Vector = (0.0, 0.0, -1.0)
    color: Vector = (1.0, 1.0, 1.0)
    intensity: float = 1.0
    range: float | None = None
    cone: tuple[float, float] = (0.0, 45.0)

    def __post_init__(self) -> None:
        check_choice("Lamp", "kind", self.kind, LAMP_KINDS)
        for name in ("position", "direction", "color"):
            object.__setattr__(self, name, vector("Lamp", name, getattr(self, name)))
        object.__setattr__(self, "intensity", number("Lamp", "intensity", self.intensity))
        if self.range is not None:
            object.__setattr__(self, "range", number("Lamp", "range", self.range))
        inner, outer = self.cone
        object.__setattr__(self, "cone", (number("Lamp", "cone", inner), number("Lamp", "cone", outer)))
