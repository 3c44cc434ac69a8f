"""The precision ladder: what may be chosen on each axis, the rungs that have a name, and the arithmetic that each of them fixes.

docs/numerics.md, sections 12 to 14, is the specification. ``bigtri/csrc/core/precision.h`` mirrors the rungs; a test keeps them
equal.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

# What each axis can be, the default first.
COVERAGES = {
    "fixed8": "edge functions in integers, vertices on a grid of 1/256 px",
    "fixed4": "the same, vertices on a grid of 1/16 px",
}
DEPTHS = {
    "float64_cell": "a float64 plane for each 64x64 px cell, rounded once to float32",
    "float32_cell": "a float32 plane for each cell",
    "float32_vertex": "a float32 plane from the record's first vertex",
    "float32_barycentric": "float32 edge values, weighted at each pixel",
    "fixed_cell": "a plane for each cell in int64, of 48 bits after the point, rounded once to float32",
    "stored24": "the default, stored on 2^24 levels",
    "stored16": "the default, stored on 2^16 levels",
    "reversed": "clip depth from w at the near plane to 0 at the far one, stored as z/w",
}
_AXES = {"coverage": COVERAGES, "depth": DEPTHS}


@dataclass(frozen=True)
class Precision:
    """What is computed in which arithmetic, an axis each; docs/accuracy.md says what each choice gives up.

    Not every mix is compiled: those that have a name are, see ``RUNGS``. The reference computes all.

    Raises:
        TypeError, ValueError: an axis is none of what it can be; the text names it.
    """

    coverage: str = "fixed8"  # which pixels a triangle covers; one of COVERAGES
    depth: str = "float64_cell"  # how the depth of a pixel is computed and stored; one of DEPTHS

    def __post_init__(self) -> None:
        for field in fields(self):
            value, allowed = getattr(self, field.name), _AXES[field.name]
            names = ", ".join(map(repr, allowed))
            if not isinstance(value, str):
                raise TypeError(f"bigtri.Precision: {field.name} must be one of {names}, got {value!r}")
            if value not in allowed:
                raise ValueError(f"bigtri.Precision: {field.name} must be one of {names}, got {value!r}")


_SUBPIXEL_BITS = {"fixed8": 8, "fixed4": 4}


@dataclass(frozen=True)
class Arithmetic:
    """A precision as the stages of the reference take it: what decides its bits.

    "subpx", the unit of snapped coordinates, is 2^-subpixel_bits px. Every proof about the widths of integers is made for 8
    sub-pixel bits; fewer bits make every integer shorter.
    """

    name: str  # the rung's, or what the precision is where it is none
    precision: Precision

    @property
    def subpixel_bits(self) -> int:
        """4 or 8."""
        return _SUBPIXEL_BITS[self.precision.coverage]

    @property
    def subpixel(self) -> int:
        """Subpx per px."""
        return 1 << self.subpixel_bits

    @property
    def half(self) -> int:
        """How far a pixel's centre lies from its left and upper borders, subpx."""
        return self.subpixel // 2

    @property
    def guard(self) -> int:
        """Snapped coordinates lie in [-guard, guard - 1] subpx: 2^15 px to either side of the upper left corner."""
        return 1 << (15 + self.subpixel_bits)

    @property
    def reversed(self) -> bool:
        """Whether clip depth runs from w at the near plane to 0 at the far one."""
        return self.precision.depth == "reversed"


# The ladder, the default first: one step down at a time, on one axis.
_LADDER = {
    "exact": Precision(),
    "subpixel4": Precision(coverage="fixed4"),
    **{f"depth_{depth}": Precision(depth=depth) for depth in DEPTHS if depth != "float64_cell"},
}
RUNGS = {name: Arithmetic(name, precision) for name, precision in _LADDER.items()}
PRECISIONS = tuple(RUNGS)
DEFAULT = PRECISIONS[0]
EXACT = RUNGS[DEFAULT]
_NAMED = {rung.precision: rung for rung in RUNGS.values()}


def arithmetic_of(precision: Precision) -> Arithmetic:
    """The rung of that precision, or an arithmetic that has no name of its own, which nothing but the reference computes."""
    return _NAMED.get(precision) or Arithmetic(repr(precision), precision)
