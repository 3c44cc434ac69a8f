"""The constants and the few formulas that more than one stage needs; docs/numerics.md sections 1 and 3.

"px" is a pixel, "subpx" the rung's sub-pixel unit, 1/256 px of `exact`. Bit widths are those of `exact`, the widest: everything
here is int64 and stays below 2^52.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..precision import EXACT, Arithmetic

MAX_SIZE = 16384  # px; 2^14, so that the whole screen lies in the inner half of the guard band
MAX_TEXTURE = 65536  # px a side; texel coordinates stay exact in float32 and int32
BIN = 64  # px; the largest power of two for which the edge function fits int32 inside a bin that the edge crosses
TILE = 8  # px; a bin's 8x8 tiles fill the 64 bits of one mask
TILES = BIN // TILE  # tiles per bin and direction
LARGE_THRESHOLD = 4000  # px of bbox; about one bin (64 * 64 = 4096): below it, a record is not worth a queue entry
BACKGROUND = 2**63 - 1  # the largest int64: loses against every fragment, whether compared as signed or as unsigned
THIN_RATIO = 32  # thin: s * sum(|dx| + |dy|) > 32 * A with s subpx a px, a height of less than about 1/16 px


class Edges(NamedTuple):
    """The three directed edges of triangles; edge k is opposite vertex k and runs from vertex k+1 to vertex k+2 (mod 3)."""

    x: NDArray[np.int64]  # [..., 3], the edge's first end, subpx
    y: NDArray[np.int64]  # [..., 3]
    dx: NDArray[np.int64]  # [..., 3], from the first end to the second, subpx, 24 bits and a sign
    dy: NDArray[np.int64]  # [..., 3]
    bias: NDArray[np.int64]  # [..., 3], 0 where the edge owns the samples on it, else -1


def edges_of(xy: NDArray[np.int32]) -> Edges:
    """Edges of the positively oriented triangles ``xy`` [..., 3, 2], subpx, with the top-left rule as a bias."""
    wide = xy.astype(np.int64)
    x, y = wide[..., [1, 2, 0], 0], wide[..., [1, 2, 0], 1]
    dx = wide[..., [2, 0, 1], 0] - x
    dy = wide[..., [2, 0, 1], 1] - y
    owns = (dy < 0) | ((dy == 0) & (dx > 0))  # left, or top
    return Edges(x, y, dx, dy, owns.astype(np.int64) - 1)


def edge_values(edges: Edges, px: NDArray[np.int64], py: NDArray[np.int64], arithmetic: Arithmetic = EXACT) -> NDArray[np.int64]:
    """The unbiased edge functions e_k [..., 3] at the centres of the pixels (px, py) [...].

    In subpx^2. Two products of a 25 bit difference and a 25 bit difference: 51 bits and a sign, exact in float64 too.
    """
    return edge_values_of_each(edges, np.asarray(px, np.int64)[..., None], np.asarray(py, np.int64)[..., None], arithmetic)


def edge_values_of_each(
    edges: Edges, px: NDArray[np.int64], py: NDArray[np.int64], arithmetic: Arithmetic = EXACT
) -> NDArray[np.int64]:
    """The same, at the centre of a pixel (px, py) [..., 3] for each edge."""
    sample_x, sample_y = arithmetic.subpixel * px + arithmetic.half, arithmetic.subpixel * py + arithmetic.half
    return edges.dx * (sample_y - edges.y) - edges.dy * (sample_x - edges.x)


def stepped_values(
    edges: Edges, px: NDArray[np.int64], py: NDArray[np.int64], arithmetic: Arithmetic = EXACT
) -> NDArray[np.int64]:
    """f = floor((e + bias) / s) [..., 3] at the centres of the pixels (px, py) [...]; covered where all three are >= 0.

    s is the number of subpx in a px. A step of one pixel changes e by a multiple of s, hence f by exactly -dy in x and +dx
    in y.
    """
    return stepped_values_of_each(edges, np.asarray(px, np.int64)[..., None], np.asarray(py, np.int64)[..., None], arithmetic)


def stepped_values_of_each(
    edges: Edges, px: NDArray[np.int64], py: NDArray[np.int64], arithmetic: Arithmetic = EXACT
) -> NDArray[np.int64]:
    """The same, at the centre of a pixel (px, py) [..., 3] for each edge.

    Where values wrap around, they are computed at the first centre of the pixel's 64x64 px cell alone, in int32. f there has 24
    bits, and the steps within the cell leave it in int32, so nothing else wraps: in a cell f is linear, right or wrong.
    """
    if not arithmetic.wraps:
        return (edge_values_of_each(edges, px, py, arithmetic) + edges.bias) >> arithmetic.subpixel_bits
    left, top = px - px % BIN, py - py % BIN
    value = (edge_values_of_each(edges, left, top, arithmetic) + edges.bias).astype(np.int32)  # the lower 32 bits
    return (value >> arithmetic.subpixel_bits) + (edges.dx * (py - top) - edges.dy * (px - left))


def ramp(counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """0, 1, ..., counts[0] - 1, 0, 1, ..., counts[1] - 1, ...: the position within its group of each of sum(counts) elements."""
    ends = np.cumsum(counts, dtype=np.int64)
    total = int(ends[-1]) if ends.size else 0
    return np.arange(total, dtype=np.int64) - np.repeat(ends - counts, counts)
