"""Pictures that explain a drawing: what is where, how far, how often, and what the method did to find out. uint8 [H, W, 3], sRGB.

Each is computed from the buffers or from the stages themselves, so that a picture cannot disagree with what was drawn.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..check import stages
from ..choices import VIEWS
from ..ops.rasterize import Visibility
from ..precision import EXACT
from ..reference.numerics import BIN, LARGE_THRESHOLD, TILE
from ..reference.records import Records
from ..reference.shading import encode_srgb
from ..scene.camera import Camera
from ..scene.scene import Scene
from ..scene.vectors import Vector
from . import figure
from .figure import Color
from .render import render

_BACKGROUND: Color = (38, 46, 66)  # for what is not there: a dark blue that no grey, normal or id is taken for
_REJECTED: Color = (214, 62, 62)
_PARTIAL: Color = (242, 166, 54)
_FULL: Color = (84, 186, 98)
_KEPT: Color = (236, 240, 246)
_OUTLINE: Color = (120, 214, 255)

# Overdraw: dark violet over red to a light yellow, rising in lightness throughout, so that it reads without colour too.
_RAMP = np.array(
    [(20, 11, 53), (84, 15, 109), (165, 44, 96), (225, 83, 54), (251, 155, 6), (252, 220, 98), (252, 255, 214)], np.float64
)


def picture(
    view: str,
    scene: Scene,
    camera: Camera,
    resolution: tuple[int, int],
    *,
    backend: str = "auto",
    supersample: int = 1,
    triangle: int | None = None,
    threshold: int | None = None,
    transparent: bool = False,
    background: tuple[Vector, Vector] | None = None,
) -> NDArray[np.uint8]:
    """One of ``VIEWS`` of a scene, uint8 [H, W, 3], or [H, W, 4] where it is transparent.

    Args:
        view: its name.
        scene, camera: what is seen, and from where.
        resolution: (height, width).
        backend: as for ``render``.
        supersample: of "shaded" alone.
        triangle, threshold: of "bins" alone; as for ``bins``.
        transparent, background: of "shaded" alone; as for ``render``.

    Raises:
        ValueError: an unknown view, or a triangle that is none.
    """
    if view not in VIEWS:
        raise ValueError(f"bigtri.views: view must be one of {', '.join(map(repr, VIEWS))}, got {view!r}")
    if view == "shaded":
        return render(
            scene,
            camera,
            resolution,
            backend=backend,
            supersample=supersample,
            transparent=transparent,
            background=background,
        )
    image, buffers = render(scene, camera, resolution, backend=backend, return_buffers=True)
    if view == "normals":
        lit = buffers.normals if buffers.normals is not None else np.zeros_like(buffers.linear)
        return normals(lit, buffers.visibility)
    if view == "depth":
        return depth(buffers.visibility, camera)
    if view == "ids":
        return triangle_ids(buffers.visibility)
    if view == "overdraw":
        return overdraw(buffers.positions, scene.triangles, resolution, cull=scene.cull, backend=backend)
    return bins(
        buffers.positions,
        scene.triangles,
        resolution,
        triangle=triangle,
        threshold=threshold,
        backdrop=image,
        cull=scene.cull,
        backend=backend,
    )


def normals(normals: NDArray[np.float32], visibility: Visibility) -> NDArray[np.uint8]:
    """World-space normals float32 [H, W, 3], of any length, x, y, z from -1..1 to red, green, blue."""
    length = np.sqrt(np.sum(normals.astype(np.float64) ** 2, axis=-1, keepdims=True))
    unit = np.divide(normals, length, out=np.zeros(normals.shape), where=length > 0)
    return _over_background(np.rint(127.5 * (unit + 1)).astype(np.uint8), visibility)


def depth(visibility: Visibility, camera: Camera) -> NDArray[np.uint8]:
    """Distance along the view direction: near is light, far dark, in equal steps of lightness; blue where nothing is."""
    covered = visibility.triangle >= 0
    assert isinstance(visibility.depth, np.ndarray)  # render always asks for it
    distance = camera.distance_from_depth(np.where(covered, visibility.depth, 0).astype(np.float64))
    low, high = (distance[covered].min(), distance[covered].max()) if covered.any() else (1.0, 1.0)
    # By the logarithm, equal ratios of distance are equal steps: the foreground keeps its shape in a deep scene.
    nearness = np.ones_like(distance)
    if high > low:
        nearness = 1 - np.log(np.clip(distance, low, high) / low) / np.log(high / low)
    lightness = 12 + 84 * nearness  # CIE L*
    luminance = np.where(lightness > 8, ((lightness + 16) / 116) ** 3, lightness / 903.3)
    return _over_background(np.repeat(encode_srgb(luminance.astype(np.float32))[..., None], 3, axis=-1), visibility)


def triangle_ids(visibility: Visibility) -> NDArray[np.uint8]:
    """A colour per triangle, from a hash of its index, so that neighbours differ and every picture agrees."""
    h = np.maximum(visibility.triangle, 0).astype(np.uint32) + np.uint32(0x9E3779B9)
    for multiplier, shift in ((0x85EBCA6B, 16), (0xC2B2AE35, 13)):
        h = (h ^ (h >> np.uint32(shift))) * np.uint32(multiplier)
    h = h ^ (h >> np.uint32(16))
    hue = (h & np.uint32(0xFFFF)) / 65536.0
    saturation = 0.35 + 0.45 * ((h >> np.uint32(16)) & np.uint32(0xFF)) / 255.0
    value = 0.6 + 0.4 * (h >> np.uint32(24)) / 255.0
    corner = np.abs((hue[..., None] + np.array([1, 2 / 3, 1 / 3])) % 1 * 6 - 3)
    rgb = value[..., None] * (1 + saturation[..., None] * (np.clip(corner - 1, 0, 1) - 1))
    return _over_background(np.rint(255 * rgb).astype(np.uint8), visibility)


def overdraw(
    positions: NDArray[np.float32],
    triangles: NDArray[np.int32],
    resolution: tuple[int, int],
    *,
    cull: str = "none",
    backend: str = "auto",
) -> NDArray[np.uint8]:
    """How many triangles cover each pixel, whether they are seen or hidden, with a colour bar.

    Args:
        positions: float32 [V, 4], clip space.
        triangles: int32 [T, 3].
        resolution: (height, width).
        cull, backend: as for ``rasterize``.
    """
    count = fragment_counts(positions, triangles, resolution, cull=cull, backend=backend)
    top = max(int(count.max()), 1)
    image = np.where((count > 0)[..., None], figure.ramp(_RAMP, count / top), np.array(_BACKGROUND)).astype(np.uint8)
    covered = int((count > 0).sum())
    mean = count.sum() / covered if covered else 0.0
    title = f"fragments per pixel: at most {int(count.max())}, {mean:.2f} on average where any"
    return figure.with_color_bar(image, _RAMP, top, title)


def fragment_counts(
    positions: NDArray[np.float32],
    triangles: NDArray[np.int32],
    resolution: tuple[int, int],
    *,
    cull: str = "none",
    backend: str = "auto",
) -> NDArray[np.int64]:
    """int64 [H, W]: fragments per pixel, from the spans; arguments as for ``overdraw``."""
    height, width = resolution
    records, _ = stages.setup(positions, triangles, height, width, cull, backend=backend)
    candidates, kept, small = stages.binning(records, backend=backend)
    queue = candidates[kept]
    touched, _ = stages.tile_mask(records, queue, backend=backend)
    spans = stages.scanline(records, queue, touched, small, backend=backend).astype(np.int64)
    change = np.zeros((height, width + 1), np.int64)
    np.add.at(change, (spans[:, 1], spans[:, 2]), 1)
    np.add.at(change, (spans[:, 1], spans[:, 3]), -1)
    return np.cumsum(change, axis=1)[:, :width]


def bins(
    positions: NDArray[np.float32],
    triangles: NDArray[np.int32],
    resolution: tuple[int, int],
    *,
    triangle: int | None = None,
    threshold: int | None = None,
    backdrop: NDArray[np.uint8] | None = None,
    cull: str = "none",
    backend: str = "auto",
) -> NDArray[np.uint8]:
    """The method: the bins that bounding boxes touch, those that an edge rejects, and the tiles left, partly and fully covered.

    Args:
        positions: float32 [V, 4], clip space.
        triangles: int32 [T, 3].
        resolution: (height, width).
        triangle: show this one alone, with its outline and bounding box.
        threshold: px of the bounding box above which a triangle is drawn by bins; None: what the method has, 4000, and 0 for a
            triangle alone. Models of small triangles have nothing to show unless it is lower.
        backdrop: uint8 [H, W, 3], shown faintly underneath.
        cull, backend: as for ``rasterize``.

    Raises:
        ValueError: a triangle that is none.
    """
    height, width = resolution
    if triangle is not None and not 0 <= triangle < len(triangles):
        raise ValueError(f"bigtri.views: triangle must be one of the {len(triangles)}, from 0, got {triangle}")
    chosen = triangles if triangle is None else triangles[triangle : triangle + 1]
    # A single triangle is shown in bins whatever its size; of a scene, only what the method does bin.
    if threshold is None:
        threshold = LARGE_THRESHOLD if triangle is None else 0
    records, _ = stages.setup(positions, chosen, height, width, cull, backend=backend)
    candidates, kept, small = stages.binning(records, threshold, backend=backend)
    queue = candidates[kept]
    touched, full = stages.tile_mask(records, queue, backend=backend)

    columns, rows = -(-width // BIN), -(-height // BIN)
    considered, used = _per_bin(candidates, columns, rows), _per_bin(queue, columns, rows)
    is_full = _any_tile(queue, full, columns, rows)
    is_partial = _any_tile(queue, touched & ~full, columns, rows) & ~is_full

    image = figure.faint(backdrop, (height, width), _BACKGROUND)
    rejected = figure.grow((considered > 0) & (used == 0), BIN, (height, width))
    image = figure.tint(image, rejected, _REJECTED, 0.42)
    gap = figure.inside((height, width), TILE)  # tiles are told apart by a line of the backdrop
    image = figure.tint(image, figure.grow(is_partial, TILE, (height, width)) & gap, _PARTIAL, 0.62)
    image = figure.tint(image, figure.grow(is_full, TILE, (height, width)) & gap, _FULL, 0.55)
    border = ~figure.inside((height, width), BIN)
    image = figure.tint(image, figure.grow(considered > 0, BIN, (height, width)) & border, _KEPT, 0.5)

    image = _outlined(image, records) if triangle is not None else figure.labelled_bins(image, used, considered, BIN)
    fully, partly = count_bits(full), count_bits(touched & ~full)
    dropped = len(candidates) - len(queue)
    share = f" ({100 * dropped / len(candidates):.0f} %)" if len(candidates) else ""
    entries = [
        (_KEPT, f"{len(candidates)} bins touched by bounding boxes" + ("" if triangle is not None else " (kept / all in each)")),
        (_REJECTED, f"{dropped} rejected by an edge{share}" + ("" if triangle is not None else "; red: nothing left")),
        (_PARTIAL, f"{partly} tiles partly covered"),
        (_FULL, f"{fully} tiles fully covered: no edge arithmetic"),
    ]
    if triangle is None and len(small):
        entries.append((_BACKGROUND, f"{len(small)} small triangles: the direct path"))
    return figure.with_legend(image, entries)


def _per_bin(entries: NDArray[np.int32], columns: int, rows: int) -> NDArray[np.int64]:
    """int64 [rows, columns]: entries (record, bin column, bin row) of each bin of the screen."""
    return np.bincount(entries[:, 2].astype(np.int64) * columns + entries[:, 1], minlength=rows * columns).reshape(rows, columns)


def _any_tile(queue: NDArray[np.int32], masks: NDArray[np.int64], columns: int, rows: int) -> NDArray[np.bool_]:
    """bool [8 * rows, 8 * columns]: tiles that are set in any entry's mask."""
    union = np.zeros((rows, columns), np.int64)
    np.bitwise_or.at(union, (queue[:, 2], queue[:, 1]), masks)
    bits = (union[:, :, None] >> np.arange(64)) & 1
    return (bits.reshape(rows, columns, 8, 8).transpose(0, 2, 1, 3).reshape(8 * rows, 8 * columns)) != 0


def count_bits(masks: NDArray[np.int64]) -> int:
    """How many tiles are set in masks [N] together."""
    return int(np.unpackbits(np.ascontiguousarray(masks).view(np.uint8)).sum())


def _outlined(image: NDArray[np.uint8], records: Records) -> NDArray[np.uint8]:
    for (x0, y0, x1, y1), corners in zip(records.bbox.tolist(), records.xy / EXACT.subpixel, strict=True):
        image = figure.polygon(image, [(x0, y0), (x1, y0), (x1, y1), (x0, y1)], _KEPT, 1)
        image = figure.polygon(image, [tuple(corner) for corner in corners.tolist()], _OUTLINE, 2)
    return image


def _over_background(image: NDArray[np.uint8], visibility: Visibility) -> NDArray[np.uint8]:
    return np.where((visibility.triangle >= 0)[..., None], image, np.array(_BACKGROUND, np.uint8))
