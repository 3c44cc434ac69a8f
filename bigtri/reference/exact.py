"""Sums of products in float64 that are rounded once, however much cancels on the way; docs/numerics.md 2.1.

Error-free transformations: T. J. Dekker, "A floating-point technique for extending the available precision", 1971 (the product);
D. E. Knuth, TAOCP 2, 4.2.2 (the sum); J. R. Shewchuk, "Adaptive precision floating-point arithmetic", 1997, section 2.4 (the
expansion). They use nothing but + - *, so every machine gets the same bits. Exact as long as no product leaves the normal range.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Doubles = NDArray[np.float64]

_SPLIT = 2.0**27 + 1  # cuts 53 bits into 26 and 26 (and a sign)


def two_sum(a: Doubles, b: Doubles) -> tuple[Doubles, Doubles]:
    """The rounded sum and its error: a + b exactly."""
    total = a + b
    shadow = total - a
    return total, (a - (total - shadow)) + (b - shadow)


def two_product(a: Doubles, b: Doubles) -> tuple[Doubles, Doubles]:
    """The rounded product and its error: a * b exactly."""
    product = a * b
    a_high, a_low = _split(a)
    b_high, b_low = _split(b)
    error = product - a_high * b_high
    error = error - a_low * b_high
    error = error - a_high * b_low
    return product, a_low * b_low - error


def _split(a: Doubles) -> tuple[Doubles, Doubles]:
    c = _SPLIT * a
    high = c - (c - a)
    return high, a - high


def rounded_sum(terms: Sequence[Doubles]) -> Doubles:
    """The exact sum of the terms, rounded once, half to even."""
    # An expansion: parts in ascending order whose bits do not overlap, so that together they are the exact sum. Some may be zero.
    parts: list[Doubles] = []
    for term in terms:
        for i, part in enumerate(parts):
            term, parts[i] = two_sum(term, part)
        parts.append(term)
    # From the largest part down until something does not fit: that is what rounding leaves out, and its sign is the rest's.
    total, rest, below = parts[-1], np.zeros_like(parts[-1]), np.zeros_like(parts[-1])
    for part in reversed(parts[:-1]):
        fits = rest == 0
        below = np.where(~fits & (below == 0), part, below)
        next_total, next_rest = two_sum(total, part)
        total, rest = np.where(fits, next_total, total), np.where(fits, next_rest, rest)
    # If the rest looked like exactly half a unit, rounding went to even; what lies below it decides the other way.
    doubled = 2 * rest
    moved = total + doubled
    beyond_half = (np.sign(rest) * np.sign(below) > 0) & (moved - total == doubled)
    return np.where(beyond_half, moved, total)
