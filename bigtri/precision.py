"""The rungs of the precision ladder: the arithmetic that each of them fixes; docs/numerics.md, section 12."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Arithmetic:
    """One rung: the numbers that decide its bits. "subpx", the unit of snapped coordinates, is 2^-subpixel_bits px.

    Every proof about the widths of integers is made for 8 sub-pixel bits; fewer bits make every integer shorter.
    """

    name: str
    subpixel_bits: int  # 1 to 8

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


# The ladder, the default first.
RUNGS = {
    rung.name: rung
    for rung in (
        Arithmetic("exact", subpixel_bits=8),
        Arithmetic("subpixel4", subpixel_bits=4),
    )
}
PRECISIONS = tuple(RUNGS)
DEFAULT = PRECISIONS[0]
EXACT = RUNGS[DEFAULT]
