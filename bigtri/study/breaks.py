"""A picture of each rung's break: what exact draws of a scene that shows it, what the rung draws, and the pixels that differ."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..hard_cases import constructions
from ..ops.interpolate import barycentrics
from ..ops.rasterize import rasterize
from ..precision import DEFAULT, RUNGS
from ..reference import binning, setup, tile_mask
from ..reference.numerics import TILE
from ..rendering import figure
from . import accuracy

Image = NDArray[np.uint8]
_PINK = (255, 60, 160)
_YELLOW = (255, 214, 10)
_BACKGROUND = (30, 34, 46)
_PANEL = 330  # px: about the width of each of the three


class Break(NamedTuple):
    """Where a rung breaks."""

    scene: Callable[[], accuracy.Case]
    window: tuple[int, int, int, int]  # first column and row, and those after the last, px
    note: str
    show: str = "triangles"  # or "texture", "depth", "tiles"


def _mesh(build: Callable[[], list[object]]) -> Callable[[], accuracy.Case]:
    return lambda: accuracy.hard(build)


_TIES = (98, 98, 158, 143)
BREAKS: dict[str, Break] = {
    "subpixel4": Break(accuracy.HARD["needles"], (360, 366, 440, 426), "400 needles: edges lie up to 1/32 px off"),
    "coverage_float32": Break(accuracy.HARD["far_fan"], (0, 0, 960, 540), "48 triangles from an apex 36,000 px away"),
    "coverage_float32_fused": Break(accuracy.HARD["needles"], (360, 366, 440, 426), "400 needles around a pixel's centre"),
    "coverage_float32_canonical": Break(accuracy.HARD["far_fan"], (0, 0, 960, 540), "no crack, but pixels change hands"),
    "coverage_float32_inclusive": Break(accuracy.HARD["ties"], _TIES, "24 spokes through pixel centres, each drawn twice"),
    "coverage_float32_strict": Break(accuracy.HARD["ties"], _TIES, "24 spokes through pixel centres, drawn by nobody"),
}
