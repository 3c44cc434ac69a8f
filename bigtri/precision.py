"""The precision ladder: what may be chosen on each axis, the rungs that have a name, and the arithmetic that each of them fixes.

docs/numerics.md, sections 12 to 14, is the specification. ``bigtri/csrc/core/precision.h`` mirrors the rungs; a test keeps them
equal.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

# What each axis can be, the default first.
COVERAGES = {
    "fixed8": "edge functions in integers, vertices on a grid of 1/256 px",
    "fixed4": "the same, on a grid of 1/16 px",
    "fixed12": "the same, on a grid of 1/4096 px, in int64 at each pixel",
    "fixed16": "the same, on a grid of 1/65536 px, in int64 at each pixel, and with a guard band of 2^14 px",
    "fixed8_int64": "as fixed8, in int64 at each pixel",
    "fixed8_int32": "as fixed8, in int32 alone, which wraps around where a triangle is larger than some 118 px",
    "float32": "edge functions in float32, of vertices on a grid of 1/256 px, and the top-left rule",
    "float32_fused": "the same, with one product that is not rounded, as compilers contract it",
    "float32_canonical": "as float32, each edge computed in one direction for both of its triangles",
    "float32_inclusive": "edge functions in float32 of vertices that are not snapped, all >= 0",
    "float32_strict": "the same, all > 0",
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
MASKS = {
    "corners": "a bin or tile is rejected if an edge has the centres of all its pixels outside: those at its corners tell",
    "half_tile": "a bin or tile is rejected if an edge has all of its square outside: half its size around its centre",
    "bounds": "no edge rejects a bin or tile; the bounding box does",
    "none": "nothing rejects a tile of a bin that the bounding box touches",
}
CLIPS = {
    "exact": "new vertices from the ends of original edges, by sums that are rounded once: neighbours get the same ones",
    "float32": "new vertices from the polygon's own edges, in the order of its vertices, in float32",
    "none": "a triangle that a plane cuts is not drawn",
}
ATTRIBUTES = {
    "float64": "perspective at each pixel in float64, rounded once to float32",
    "float32": "the same in float32",
    "reciprocal": "the same in float32, by products with reciprocals: an integer start and two Newton steps",
    "affine": "linear on the screen, without perspective",
    "unsnapped": "perspective in float64 of the triangle as it was given, from vertices that are not snapped",
}
_AXES = {"coverage": COVERAGES, "depth": DEPTHS, "mask": MASKS, "clip": CLIPS, "attributes": ATTRIBUTES}


@dataclass(frozen=True)
class Precision:
    """What is computed in which arithmetic, an axis each; docs/accuracy.md says what each choice gives up.

    Not every mix is compiled: those that have a name are, see ``RUNGS``. The reference computes all.

    Raises:
        TypeError, ValueError: an axis is none of what it can be, or two exclude each other; the text names them.
    """

    coverage: str = "fixed8"  # which pixels a triangle covers; one of COVERAGES
    depth: str = "float64_cell"  # how the depth of a pixel is computed and stored; one of DEPTHS
    mask: str = "corners"  # which bins and tiles are looked at; one of MASKS. It changes no pixel
    clip: str = "exact"  # what becomes of a triangle that crosses a plane; one of CLIPS
    attributes: str = "float64"  # how attributes are weighted at a pixel; one of ATTRIBUTES

    def __post_init__(self) -> None:
        for field in fields(self):
            value, allowed = getattr(self, field.name), _AXES[field.name]
            names = ", ".join(map(repr, allowed))
            if not isinstance(value, str):
                raise TypeError(f"bigtri.Precision: {field.name} must be one of {names}, got {value!r}")
            if value not in allowed:
                raise ValueError(f"bigtri.Precision: {field.name} must be one of {names}, got {value!r}")
        if self.mask == "half_tile" and self.coverage.startswith("float32"):
            raise ValueError(
                f"bigtri.Precision: mask must not be 'half_tile' with coverage {self.coverage!r}: a value at a tile's centre, "
                "and how far it can rise from there, are rounded apart from those at its pixels, and prove nothing about these"
            )


_SUBPIXEL_BITS = {"fixed4": 4, "fixed12": 12, "fixed16": 16}  # 8 for any other coverage
_UNSNAPPED = ("float32_inclusive", "float32_strict")


@dataclass(frozen=True)
class Arithmetic:
    """A precision as the stages of the reference take it: what decides its bits.

    "subpx", the unit of snapped coordinates, is 2^-subpixel_bits px. Every proof about the widths of integers is made for 8
    sub-pixel bits; fewer bits make every integer shorter, and docs/numerics.md 14 says what holds for more.
    """

    name: str  # the rung's, or what the precision is where it is none
    precision: Precision

    @cached_property
    def subpixel_bits(self) -> int:
        """4, 8, 12 or 16."""
        return _SUBPIXEL_BITS.get(self.precision.coverage, 8)

    @cached_property
    def subpixel(self) -> int:
        """Subpx per px."""
        return 1 << self.subpixel_bits

    @cached_property
    def half(self) -> int:
        """How far a pixel's centre lies from its left and upper borders, subpx."""
        return self.subpixel // 2

    @cached_property
    def guard(self) -> int:
        """Snapped coordinates lie in [-guard, guard - 1] subpx: 2^15 px to either side of the upper left corner, or 2^14 px.

        2^14 px with 16 bits, so that a coordinate has 31 bits and a product of two differences fits int64.
        """
        return 1 << min(15 + self.subpixel_bits, 30)

    @property
    def has_float_coverage(self) -> bool:
        """Whether edge functions are computed in float32."""
        return self.precision.coverage.startswith("float32")

    @property
    def is_unsnapped(self) -> bool:
        """Whether coverage is that of vertices that are not snapped."""
        return self.precision.coverage in _UNSNAPPED

    @property
    def wraps(self) -> bool:
        """Whether edge values are computed in int32, and wrap around where they do not fit."""
        return self.precision.coverage == "fixed8_int32"

    @property
    def has_stages(self) -> bool:
        """Whether the extension has the stages one by one.

        Not where coverage needs vertices that are not snapped, or where a row's covered pixels may lie apart.
        """
        return not (self.is_unsnapped or self.wraps)

    @property
    def reversed(self) -> bool:
        """Whether clip depth runs from w at the near plane to 0 at the far one."""
        return self.precision.depth == "reversed"


# Mixes by what they are for, the default first. None gives up coverage: whatever the preset, a shared edge is drawn once.
_PRESETS = {
    "exact": Precision(),
    "balanced": Precision(attributes="float32"),
    "fast": Precision(depth="float32_cell", attributes="float32"),
}
# The ladder: one step down at a time, on one axis. ``balanced`` is such a step too, under the name by which every build has it.
_LADDER = {
    "subpixel4": Precision(coverage="fixed4"),
    "subpixel12": Precision(coverage="fixed12"),
    "subpixel16": Precision(coverage="fixed16"),
    "coverage_int64": Precision(coverage="fixed8_int64"),
    "coverage_int32": Precision(coverage="fixed8_int32"),
    **{f"coverage_{coverage}": Precision(coverage=coverage) for coverage in COVERAGES if coverage.startswith("float32")},
    **{f"depth_{depth}": Precision(depth=depth) for depth in DEPTHS if depth != "float64_cell"},
    **{f"mask_{mask}": Precision(mask=mask) for mask in MASKS if mask != "corners"},
    **{f"clip_{clip}": Precision(clip=clip) for clip in CLIPS if clip != "exact"},
    **{f"attributes_{rule}": Precision(attributes=rule) for rule in ATTRIBUTES if rule != "float64"},
}
RUNGS = {name: Arithmetic(name, precision) for name, precision in {**_PRESETS, **_LADDER}.items()}
PRECISIONS = tuple(RUNGS)
PRESETS = tuple(_PRESETS)
DEFAULT = PRECISIONS[0]
EXACT = RUNGS[DEFAULT]
_NAMED = {rung.precision: rung for rung in reversed(RUNGS.values())}  # the first one of two names


def arithmetic_of(precision: Precision) -> Arithmetic:
    """The rung of that precision, or an arithmetic that has no name of its own, which nothing but the reference computes."""
    return _NAMED.get(precision) or Arithmetic(repr(precision), precision)
