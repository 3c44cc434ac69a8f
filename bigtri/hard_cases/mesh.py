"""What a hard case is, the exact coverage of a mesh in integers, and how many pixels a backend draws differently.

Nothing here is shared with ``bigtri.reference``: the truth is computed another way, from the integers that a construction
was made of. "px" is a pixel, "subpx" is 1/256 px, y points down.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from ..check import stages
from ..ops.rasterize import Visibility, rasterize
from ..reference.records import Records
from . import naive

SUBPX = 256
Mask = NDArray[np.bool_]
Box = tuple[int, int, int, int]  # x0, y0, x1, y1, px, half-open


class Backend(NamedTuple):
    """What is put to the test: "reference" or "native", the latter on the instruction set in use, and where the tensors are."""

    name: str
    device: str = "cpu"

    def draw(self, positions: Any, triangles: Any, resolution: tuple[int, int], **options: Any) -> Visibility:
        """NumPy in and out; ``out`` may be a NumPy array, which is written."""
        clip, faces = (torch.from_numpy(np.array(a)).to(self.device) for a in (positions, triangles))
        image = options.pop("out", None)
        if image is not None:
            options["out"] = torch.from_numpy(image).to(self.device)  # the same memory where the device is the CPU
        seen = rasterize(clip, faces, resolution, backend=self.name, **options)
        if image is not None:
            np.copyto(image, options["out"].cpu().numpy())
        packed, dropped = (np.asarray(torch.as_tensor(field).cpu()) for field in (seen.packed, seen.dropped))
        depth = None if seen.depth is None else np.asarray(torch.as_tensor(seen.depth).cpu())
        return Visibility(packed, depth, dropped)

    def setup(self, positions: Any, triangles: Any, resolution: tuple[int, int]) -> Records:
        return stages.setup(positions, triangles, *resolution, backend=self.name)[0]

    def spans(self, records: Records, threshold: int = 4000) -> NDArray[np.int32]:
        """int32 [S, 4] (record, y, lower, upper), px: everything that the records cover."""
        bins = stages.binning(records, threshold, backend=self.name)
        queue = bins.candidates[bins.kept]
        # In parts: the reference holds the 64 tiles of all entries that it is given at once.
        parts = [queue[i : i + 1024] for i in range(0, max(len(queue), 1), 1024)]
        touched = np.concatenate([stages.tile_mask(records, part, backend=self.name)[0] for part in parts])
        return stages.scanline(records, queue, touched, bins.small, backend=self.name)


class Case(NamedTuple):
    """A construction, what must hold of it, and why it is hard."""

    name: str  # "H05", or the bug report that it stands for
    family: str
    title: str
    invariant: str
    reason: str
    wrong: Callable[[Backend], int]  # how much of it this build gets wrong; 0, or there is a defect
    naive: Callable[[], dict[str, int]] | None = None  # the same for other ways to do it, by variant
    breaks: tuple[str, ...] = ()  # the variants that must get something wrong, or the case has lost its teeth
    unit: str = "px"  # what ``wrong`` and ``naive`` count
    build: Callable[[], list[Mesh]] | None = None  # the meshes that it draws, where it is about meshes


class Mesh(NamedTuple):
    """A mesh on the sub-pixel grid, or beyond it."""

    xy: NDArray[np.int64]  # [T, 3, 2], subpx
    resolution: tuple[int, int]  # height, width, px
    once: Mask | None = None  # [H, W]: pixels that exactly one triangle must cover
    raw: NDArray[np.float64] | None = None  # [T, 3, 2], subpx: what naive code gets, where that is not ``xy``
    slack: float = 0.0  # subpx: pixels whose centre is this close to an edge are not judged (clipped triangles only)

    @property
    def positions(self) -> NDArray[np.float32]:
        """Clip-space positions [3 T, 4] that snap to ``xy``, at depth 0.5."""
        return clip_space(self.xy, self.resolution)

    @property
    def triangles(self) -> NDArray[np.int32]:
        return np.arange(3 * len(self.xy), dtype=np.int32).reshape(-1, 3)


def clip_space(
    xy: NDArray[np.floating[Any]] | NDArray[np.int64], resolution: tuple[int, int], z: Any = 0.0, w: Any = 1.0
) -> NDArray[np.float32]:
    """Positions float32 [V, 4] of points [..., 2] in subpx; z is the normalized device depth, -1 near and 1 far."""
    height, width = resolution
    x, y = xy[..., 0] / (128 * width) - 1, 1 - xy[..., 1] / (128 * height)
    z, w = np.broadcast_to(z, x.shape), np.broadcast_to(w, x.shape)
    return np.stack([x * w, y * w, z * w, w], axis=-1).reshape(-1, 4).astype(np.float32)


def f32(values: Any) -> NDArray[np.float32]:
    """As a float32 array, each value rounded once."""
    return np.asarray(values, np.float32)


def positive(xy: NDArray[np.int64]) -> NDArray[np.int64]:
    """The triangle [3, 2], its last two vertices swapped if that makes its area positive (clockwise on the screen)."""
    (ax, ay), (bx, by), (cx, cy) = xy.tolist()
    return xy if (bx - ax) * (cy - ay) - (by - ay) * (cx - ax) >= 0 else xy[[0, 2, 1]]


def covered(xy: NDArray[np.int64], box: Box) -> Mask:
    """bool [y1 - y0, x1 - x0]: the pixels of the box whose centre is in the triangle [3, 2], subpx; 61 bits and a sign.

    The top-left rule as a limit: move the sample right by e, down by e^2, and let e go to 0. On an edge that leaves the
    sign of -dy, and of dx where that is 0.
    """
    x0, y0, x1, y1 = box
    inside = np.full((y1 - y0, x1 - x0), abs(_area(xy)) > 0)
    sx, sy = (SUBPX * np.arange(a, b, dtype=np.int64) + SUBPX // 2 for a, b in ((x0, x1), (y0, y1)))
    corners = positive(xy)
    for p, q in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        dx, dy = (int(v) for v in q - p)
        edge = (dx * (sy - p[1]))[:, None] - (dy * (sx - p[0]))[None, :]
        inside &= edge >= 0 if (-dy, dx) > (0, 0) else edge > 0
    return inside


def judged(xy: NDArray[np.int64], box: Box, slack: float) -> Mask:
    """The pixels of the box that are farther than ``slack`` subpx from the lines through all three edges."""
    x0, y0, x1, y1 = box
    sx, sy = (SUBPX * np.arange(a, b, dtype=np.int64) + SUBPX // 2 for a, b in ((x0, x1), (y0, y1)))
    far = np.ones((y1 - y0, x1 - x0), np.bool_)
    for p, q in zip(xy, np.roll(xy, -1, axis=0), strict=True):
        dx, dy = (int(v) for v in q - p)
        edge = (dx * (sy - p[1]))[:, None] - (dy * (sx - p[0]))[None, :]
        far &= np.abs(edge) > slack * np.hypot(dx, dy)
    return far


def box_of(xy: NDArray[np.int64], resolution: tuple[int, int]) -> Box:
    """The pixels around the triangle, one more on each side, cut to the image."""
    height, width = resolution
    (x0, y0), (x1, y1) = (xy.min(axis=0) // SUBPX - 1).tolist(), (xy.max(axis=0) // SUBPX + 2).tolist()
    x0, y0 = min(max(x0, 0), width), min(max(y0, 0), height)
    return x0, y0, max(min(x1, width), x0), max(min(y1, height), y0)


def naive_wrong(build: Callable[[], list[Mesh]]) -> dict[str, int]:
    """Pixels, summed over the triangles, that each naive variant draws differently.

    Where the naive code gets the unrounded vertices, the exact coverage of the rounded ones would be the wrong measure: pixels
    of ``once`` that are not covered exactly once are counted instead.
    """
    wrong = dict.fromkeys((*naive.VARIANTS, "fixed4"), 0)
    for mesh in build():
        raw = np.asarray(mesh.xy if mesh.raw is None else mesh.raw)
        times = {name: np.zeros(mesh.resolution, np.int64) for name in wrong}
        for xy, given in zip(mesh.xy, raw, strict=True):
            x0, y0, x1, y1 = box = box_of(xy, mesh.resolution)
            truth, counted = covered(xy, box), judged(xy, box, mesh.slack) if mesh.slack else np.True_
            corners = given if positive(xy) is xy else given[[0, 2, 1]]
            for name in wrong:
                got = covered(naive.fixed4(given), box) if name == "fixed4" else naive.coverage(name, corners, box)
                times[name][y0:y1, x0:x1] += got
                wrong[name] += int(((got != truth) & counted).sum()) if mesh.raw is None else 0
        if mesh.raw is not None and mesh.once is not None:
            for name in wrong:
                wrong[name] += int(np.abs(times[name] - 1)[mesh.once].sum())
    return wrong


def bigtri_wrong(build: Callable[[], list[Mesh]], backend: Backend) -> int:
    """Pixels that the backend draws differently: summed over the triangles as spans, and in two images of the fused call.

    All depths are equal, so one image shows the lowest index and, with the triangles reversed, the other the highest. Where
    both are right, so is the coverage of all pixels that one or two triangles cover.
    """
    return sum(_mesh_wrong(truth, backend) for truth in _truths(build))


class _Truth(NamedTuple):
    mesh: Mesh
    masks: list[tuple[Box, Mask, Mask]]  # of each triangle: a box, its coverage there, the pixels that are judged
    total: NDArray[np.int64]  # [H, W], how many triangles cover a pixel
    lowest: NDArray[np.int32]  # [H, W], the lowest index that covers a pixel, or -1
    highest: NDArray[np.int32]
    sure: Mask  # [H, W], judged by all triangles


@lru_cache(maxsize=1)  # one case after the other is put to every backend
def _truths(build: Callable[[], list[Mesh]]) -> list[_Truth]:
    return [_truth(mesh) for mesh in build()]


def _truth(mesh: Mesh) -> _Truth:
    lowest, highest = (np.full(mesh.resolution, -1, np.int32) for _ in range(2))
    sure, total, masks = np.ones(mesh.resolution, np.bool_), np.zeros(mesh.resolution, np.int64), []
    for index, xy in enumerate(mesh.xy):
        x0, y0, x1, y1 = box = box_of(xy, mesh.resolution)
        here = np.s_[y0:y1, x0:x1]
        truth = covered(xy, box)
        counted = judged(xy, box, mesh.slack) if mesh.slack else np.ones_like(truth)
        masks.append((box, truth, counted))
        sure[here] &= counted
        lowest[here] = np.where(truth & (lowest[here] < 0), index, lowest[here])
        highest[here] = np.where(truth, index, highest[here])
        total[here] += truth
    return _Truth(mesh, masks, total, lowest, highest, sure)


def _mesh_wrong(truth: _Truth, backend: Backend) -> int:
    mesh = truth.mesh
    positions, triangles = mesh.positions, mesh.triangles
    records = backend.setup(positions, triangles, mesh.resolution)
    drawn = coverage_by_triangle(records, backend.spans(records), len(mesh.xy))
    wrong = 0
    for index, (box, expected, counted) in enumerate(truth.masks):
        got, elsewhere = drawn(index, box)
        wrong += int(((got != expected) & counted).sum()) + elsewhere
    forward, backward = both_orders(positions, triangles, mesh.resolution, backend)
    wrong += int(((forward != truth.lowest) & truth.sure).sum() + ((backward != truth.highest) & truth.sure).sum())
    if mesh.once is not None:
        wrong += int(((forward < 0) & mesh.once).sum() + ((forward != backward) & mesh.once).sum())
        wrong += int(((truth.total != 1) & mesh.once & truth.sure).sum())  # else the construction itself would be wrong
    return wrong


def both_orders(
    positions: NDArray[np.float32], triangles: NDArray[np.int32], resolution: tuple[int, int], backend: Backend
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """The lowest and the highest index int32 [H, W] at each pixel, -1 on the background, of triangles at one depth."""
    forward, backward = (backend.draw(positions, order, resolution).triangle for order in (triangles, triangles[::-1]))
    return np.asarray(forward), np.where(np.asarray(backward) < 0, -1, len(triangles) - 1 - np.asarray(backward))


def coverage_by_triangle(records: Records, spans: NDArray[np.int32], count: int) -> Callable[[int, Box], tuple[Mask, int]]:
    """By triangle and box: the mask of the box, and how many pixels are covered outside of it or more than once."""
    triangle = records.triangle[spans[:, 0]]
    order = np.argsort(triangle, kind="stable")
    first = np.searchsorted(triangle[order], np.arange(count + 1))

    def mask(index: int, box: Box) -> tuple[Mask, int]:
        x0, y0, x1, y1 = box
        image = np.zeros((y1 - y0, x1 - x0), np.bool_)
        pixels = 0
        for _, y, lower, upper in spans[order[first[index] : first[index + 1]]].tolist():
            pixels += upper - lower
            if y0 <= y < y1:
                image[y - y0, max(lower - x0, 0) : max(upper - x0, 0)] = True
        return image, pixels - int(image.sum())

    return mask


def mesh_case(
    name: str,
    family: str,
    build: Callable[[], list[Mesh]],
    invariant: str,
    breaks: str = "",
) -> Case:
    """A case of a mesh; title and reason are the first line and the rest of the builder's docstring."""
    title, _, reason = (build.__doc__ or "").partition("\n")
    wrong = partial(bigtri_wrong, build)
    plain = partial(naive_wrong, build)
    text = " ".join(reason.split())
    return Case(name, family, title.rstrip("."), invariant, text, wrong, plain, tuple(breaks.split()), build=build)


def _area(xy: NDArray[np.int64]) -> int:
    (ax, ay), (bx, by), (cx, cy) = xy.tolist()
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
