"""A picture of each rung's break: what it draws of a scene that shows it, what exact draws, and the pixels that differ.

Rungs that give up nothing but time, or nothing at all, have none: ``subpixel12``, ``subpixel16``, ``coverage_int64``,
``depth_fixed_cell`` and ``attributes_unsnapped``. Presets break where the rungs do whose choices they have.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import reference
from ..hard_cases import constructions, pictures
from ..hard_cases.mesh import Box
from ..ops.interpolate import barycentrics
from ..ops.rasterize import rasterize
from ..precision import DEFAULT, RUNGS
from ..reference.numerics import TILE
from ..rendering import figure
from . import accuracy

Image = NDArray[np.uint8]
_SHEET = 330  # px: about the width of each of the three panels


class Break(NamedTuple):
    """Where a rung breaks."""

    scene: Callable[[], accuracy.Case]
    window: Box  # of the scene, px
    note: str
    draw: Callable[[accuracy.Case, str], tuple[Image, Image, Image]]  # the rung's, exact's, and the difference, of all pixels


def draw_all(folder: Path, progress: Callable[[str], None] = lambda line: None) -> list[Path]:
    """Writes all pictures as PNG files, named as the rungs; returns them. The folder is made if it is not there."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for rung in BREAKS:
        progress(f"drawing {rung}")
        paths.append(figure.save(folder / f"{rung}.png", sheet(rung)))
    return paths


def sheet(rung: str) -> Image:
    """The three panels of a rung's break side by side."""
    scene, (x0, y0, x1, y1), note, draw = BREAKS[rung]

    def cut(_: object) -> tuple[Image, Image, Image]:
        left, middle, right = (panel[y0:y1, x0:x1] for panel in draw(scene(), rung))
        return left, middle, right

    return pictures.sheet(pictures.Picture(rung, (rung, DEFAULT, "pixels that differ"), note, cut, max(1, _SHEET // (x1 - x0))))


def _drawn(case: accuracy.Case, rung: str) -> tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.float32]]:
    """Triangle [H, W], depth [H, W] and weights [H, W, 3]."""
    given = case.positions_for(rung)
    seen = rasterize(given, case.triangles, (case.height, case.width), precision=rung)
    weights = barycentrics(seen, given, case.triangles, precision=rung)
    return np.asarray(seen.triangle).astype(np.int64), np.asarray(seen.depth), np.asarray(weights)


def _triangles(case: accuracy.Case, rung: str) -> tuple[Image, Image, Image]:
    """A colour for each triangle."""
    mine, right = _drawn(case, rung)[0], _drawn(case, DEFAULT)[0]
    missing = (mine < 0) & (right >= 0)
    colored = pictures.colored(right)
    return pictures.colored(mine), colored, pictures.marked(colored, missing, (mine != right) & ~missing)


def _twice(case: accuracy.Case, rung: str) -> tuple[Image, Image, Image]:
    """The last triangle of a pixel instead of the nearest one, so that pixels drawn twice differ: for flat scenes."""
    return _triangles(case._replace(triangles=case.triangles[::-1].copy()), rung)


def _depths(case: accuracy.Case, rung: str) -> tuple[Image, Image, Image]:
    """The low bits of depth as greys; pixels that are more than one unit in the last place off."""
    mine, right = _drawn(case, rung)[1], _drawn(case, DEFAULT)[1]
    greys = [
        np.repeat((4 * (bits & 63)).astype(np.uint8)[..., None], 3, axis=2)
        for bits in (mine.view(np.int32), right.view(np.int32))
    ]
    off = np.abs(mine.view(np.int32).astype(np.int64) - right.view(np.int32)) > 1
    return greys[0], greys[1], pictures.marked(greys[1], np.zeros_like(off), off)


def _textures(texels: float) -> Callable[[accuracy.Case, str], tuple[Image, Image, Image]]:
    """A checkerboard on each triangle; pixels whose weights are more than so many texels of 1024 off."""

    def draw(case: accuracy.Case, rung: str) -> tuple[Image, Image, Image]:
        (_, _, mine), (triangle, _, right) = _drawn(case, rung), _drawn(case, DEFAULT)
        boards = []
        for weights in (mine, right):
            dark = np.floor(weights[..., :2] * 8).sum(axis=-1) % 2 == 1
            boards.append(figure.tint(pictures.colored(triangle), dark & (triangle >= 0), (20, 24, 34), 0.6))
        off = np.abs(mine - right).max(axis=-1) * accuracy.TEXTURE > texels
        return boards[0], boards[1], pictures.marked(boards[1], np.zeros_like(off), off)

    return draw


def _tiles(case: accuracy.Case, rung: str) -> tuple[Image, Image, Image]:
    """The tiles that a mask names; those that exact's does not."""
    shape = case.height, case.width
    colored = pictures.colored(_drawn(case, DEFAULT)[0])
    named = []
    for name in (rung, DEFAULT):
        arithmetic = RUNGS[name]
        records, _ = reference.setup(case.positions, case.triangles, *shape, arithmetic=arithmetic)
        bins = reference.binning(records, 0, arithmetic)
        queue = bins.candidates[bins.kept]
        touched, _ = reference.tile_mask(records, queue, arithmetic)
        named.append(figure.grow(_tile_map(queue, touched, shape), TILE, shape))
    panels = [figure.tint(colored, mask & figure.inside(shape, TILE), (240, 243, 248), 0.35) for mask in named]
    return panels[0], panels[1], pictures.marked(colored, np.zeros(shape, np.bool_), named[0] & ~named[1])


def _tile_map(queue: NDArray[np.int32], touched: NDArray[np.int64], shape: tuple[int, int]) -> NDArray[np.bool_]:
    """bool [rows, columns] of tiles: whether any record's mask has them."""
    found = np.zeros((-(-shape[0] // 64) * 8, -(-shape[1] // 64) * 8), np.bool_)
    for (_, column, row), mask in zip(queue.tolist(), touched.view(np.uint64).tolist(), strict=True):
        bits = np.array([mask >> bit & 1 for bit in range(64)], np.bool_).reshape(8, 8)
        found[8 * row : 8 * row + 8, 8 * column : 8 * column + 8] |= bits
    return found


def needle() -> accuracy.Case:
    """One long triangle across 256 x 256 px."""
    positions = np.array([[-0.93, 0.81, 0, 1], [-0.71, 0.9, 0, 1], [0.9, -0.77, 0, 1]], np.float32)
    return accuracy.Case("needle", 256, 256, positions, np.array([[0, 1, 2]], np.int32))


_HARD = accuracy.HARD
_TIES, _SPOKES, _FIGHT, _FLOOR = (98, 98, 158, 143), (360, 366, 440, 426), (0, 0, 256, 192), (0, 60, 320, 240)
_ALL, _FAN = (0, 0, 256, 256), (490, 8, 560, 74)


def _slopes() -> accuracy.Case:
    return accuracy.case("S2", 640, 360)


def _specks() -> accuracy.Case:
    return accuracy.hard(constructions.subpixel_mesh)


def _far() -> accuracy.Case:
    return accuracy.hard(constructions.beyond_the_guard_band)


BREAKS = {
    "subpixel4": Break(_specks, (0, 0, 19, 18), "Triangles smaller than a pixel, each corner up to 1/32 px off.", _triangles),
    "coverage_int32": Break(_slopes, (0, 0, 640, 360), "Triangles larger than 118 px: values that wrap around.", _triangles),
    "coverage_float32": Break(_HARD["far_fan"], _FAN, "48 triangles from an apex 36,000 px away.", _twice),
    "coverage_float32_fused": Break(_HARD["needles"], _SPOKES, "Pink: no needle is drawn. Yellow: another one, or two.", _twice),
    "coverage_float32_canonical": Break(_HARD["far_fan"], _FAN, "The same fan: no crack, but pixels change hands.", _twice),
    "coverage_float32_inclusive": Break(_HARD["ties"], _TIES, "Spokes through pixel centres: both triangles are drawn.", _twice),
    "coverage_float32_strict": Break(_HARD["ties"], _TIES, "Spokes through pixel centres: neither triangle is drawn.", _twice),
    "depth_float32_cell": Break(_slopes, (160, 60, 490, 260), "Low bits of depth. Yellow: more than 1 ulp off.", _depths),
    "depth_float32_vertex": Break(_HARD["fight"], (50, 190, 105, 232), "Strips nearer by 2^-25, 2^-24, 2^-23 ...", _triangles),
    "depth_float32_barycentric": Break(_slopes, (160, 60, 490, 260), "Low bits of depth. Yellow: more than 1 ulp off.", _depths),
    "depth_stored24": Break(_HARD["fight"], _FIGHT, "Strips nearer by 2^-25, 2^-24, 2^-23 ...", _triangles),
    "depth_stored16": Break(_HARD["fight"], _FIGHT, "Strips nearer by 2^-25, 2^-24, 2^-23 ...", _triangles),
    "depth_reversed": Break(
        _HARD["far_planes"], (0, 0, 128, 128), "Two walls 10 cm apart, 100 m away. Here exact shows the wrong one.", _triangles
    ),
    "mask_half_tile": Break(needle, _ALL, "Bright: tiles that are looked at. Yellow: not by exact.", _tiles),
    "mask_bounds": Break(needle, _ALL, "Bright: tiles that are looked at. Yellow: not by exact.", _tiles),
    "mask_none": Break(needle, _ALL, "Bright: tiles that are looked at. Yellow: not by exact.", _tiles),
    "clip_float32": Break(_far, (60, 128, 160, 198), "40 triangles with corners a million px away.", _triangles),
    "clip_none": Break(_HARD["floor"], _FLOOR, "A floor that passes under the camera.", _triangles),
    "attributes_float32": Break(_HARD["floor"], _FLOOR, "Yellow: more than 0.0001 texels of 1024 off.", _textures(0.0001)),
    "attributes_reciprocal": Break(_HARD["floor"], _FLOOR, "Yellow: more than 0.0001 texels of 1024 off.", _textures(0.0001)),
    "attributes_affine": Break(_HARD["floor"], _FLOOR, "Yellow: more than a texel of 1024 off.", _textures(1)),
}
