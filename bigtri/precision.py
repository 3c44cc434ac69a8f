"""The rungs of the precision ladder; docs/numerics.md 12. Mirrors bigtri/csrc/core/precision.h, which a test keeps equal."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Arithmetic:
    """How exactly one rung computes.

    Attributes:
        name: of the rung.
        subpixel_bits: vertices snap to 2^-subpixel_bits px.
    """

    name: str
    subpixel_bits: int

    @property
    def subpixel(self) -> int:
        """Sub-pixel units (subpx) a pixel."""
        return 1 << self.subpixel_bits

    @property
    def half(self) -> int:
        """Half a pixel, subpx: a pixel's centre lies so far into it."""
        return self.subpixel // 2

    @property
    def guard(self) -> int:
        """Snapped coordinates lie in [-guard, guard - 1] subpx, 2^15 px to either side of the screen's corner."""
        return 1 << (15 + self.subpixel_bits)


EXACT = Arithmetic("exact", 8)
SUBPIXEL4 = Arithmetic("subpixel4", 4)

# By name, the default first.
RUNGS = {rung.name: rung for rung in (EXACT, SUBPIXEL4)}
PRECISIONS = tuple(RUNGS)
DEFAULT = PRECISIONS[0]
