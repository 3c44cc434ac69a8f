"""How much work each variant does, from what the stages say: the oracle of the counters of csrc/core/counters.h."""

from . import bin_owned, scanline

# By the variant's name: a function of (records, arithmetic) that returns what it counts, by the counter's name.
COUNTS = {"bin_owned": bin_owned.count, "scanline": scanline.count}

__all__ = ["COUNTS"]
