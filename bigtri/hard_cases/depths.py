"""H30 to H36: depth. The worst error in units in the last place, and depths that should be equal and are not.

The usual ways to a depth in float32 get the triangle's snapped vertices and its float32 depths, as bigtri does; the truth is
the plane through them, as a fraction.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..check import stages
from ..reference import brute_force
from ..study import scenes
from .constructions import px
from .mesh import SUBPX, Backend, Case, clip_space, covered, f32
from .rules import soup

Points = NDArray[np.int64]
Float = NDArray[np.float32]
FORMS = ("origin", "v0", "barycentric")
_F = np.float32


class Sheet(NamedTuple):
    """Triangles with depths, and the pixels at which they are sampled."""

    xy: Points  # [T, 3, 2], subpx, on the screen
    device_z: Float  # [T, 3], normalized device depth, -1 near
    resolution: tuple[int, int]
    samples: int = 40  # pixels of each triangle

    @property
    def z(self) -> Float:
        """Window depth float32 [T, 3]."""
        return self.device_z * _F(0.5) + _F(0.5)


def naive_depth(form: str, xy: Points, z: Float, x: Float, y: Float) -> Float:
    """Depth float32 [N] at the points (x, y), px: "origin" A x + B y + C, "v0" z0 + A (x - x0) + B (y - y0), "barycentric"."""
    v = (xy / SUBPX).astype(_F)
    (ax, ay), (bx, by), (cx, cy) = v
    with np.errstate(all="ignore"):
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if form == "barycentric":
            l1 = ((cx - ax) * (ay - y) - (cy - ay) * (ax - x)) / area
            l2 = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / area
            return ((_F(1) - l1 - l2) * z[0] + l1 * z[1]) + l2 * z[2]
        dz1, dz2 = z[1] - z[0], z[2] - z[0]
        slope_x = (dz1 * (cy - ay) - dz2 * (by - ay)) / area
        slope_y = (dz2 * (bx - ax) - dz1 * (cx - ax)) / area
        if form == "v0":
            return z[0] + slope_x * (x - ax) + slope_y * (y - ay)
        return slope_x * x + slope_y * y + (z[0] - slope_x * ax - slope_y * ay)


def exact_depth(xy: Points, z: Float, x: int, y: int) -> Fraction:
    """The plane through the vertices at the centre of pixel (x, y)."""
    (ax, ay), (bx, by), (cx, cy) = xy.tolist()
    sx, sy = SUBPX * x + SUBPX // 2, SUBPX * y + SUBPX // 2
    e1 = (ax - cx) * (sy - cy) - (ay - cy) * (sx - cx)
    e2 = (bx - ax) * (sy - ay) - (by - ay) * (sx - ax)
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    z0, z1, z2 = (Fraction(float(v)) for v in z)
    return z0 + ((z1 - z0) * e1 + (z2 - z0) * e2) / area


def _ulps(got: float, exact: Fraction) -> float:
    """The error in units in the last place of the float32 nearest to the exact value; 2^31 if there is no number at all."""
    if not np.isfinite(got):
        return 2.0**31
    return float(abs(Fraction(got) - exact) / Fraction(float(np.spacing(_F(float(exact))))))


class _Samples(NamedTuple):
    triangle: NDArray[np.int64]
    x: NDArray[np.int64]
    y: NDArray[np.int64]
    exact: list[Fraction]


@lru_cache(maxsize=2)
def _samples(build: Callable[[], Sheet]) -> _Samples:
    sheet = build()
    rng = np.random.default_rng(30)
    height, width = sheet.resolution
    found: list[tuple[int, int, int]] = []
    for t, xy in enumerate(sheet.xy):
        low, high = np.clip(xy.min(0) // SUBPX, 0, [width, height]), np.clip(xy.max(0) // SUBPX + 1, 0, [width, height])
        box = (int(low[0]), int(low[1]), int(high[0]), int(high[1]))
        y, x = np.nonzero(covered(xy, box))
        chosen = rng.permutation(len(x))[: sheet.samples]
        found += [(t, int(x[i]) + box[0], int(y[i]) + box[1]) for i in chosen]
    t, x, y = np.array(found).T
    return _Samples(t, x, y, [exact_depth(sheet.xy[k], sheet.z[k], i, j) for k, i, j in found])


def fragments(backend: Backend, positions: Any, triangles: Any, resolution: tuple[int, int]) -> NDArray[np.float32]:
    """float32 [T, H, W]: the depth of every pixel of each of a few unclipped triangles, NaN where it covers none."""
    records = backend.setup(positions, triangles, resolution)
    spans = backend.spans(records)
    depth = stages.depth(records, spans, backend=backend.name)
    y, x, triangle = _places(records.triangle, spans)
    image = np.full((len(triangles), *resolution), np.nan, np.float32)
    image[triangle, y, x] = depth
    return image


def worst(build: Callable[[], Sheet], backend: Backend) -> float:
    """The backend's worst error at the samples, ulp."""
    sheet, at = build(), _samples(build)
    positions = clip_space(sheet.xy, sheet.resolution, sheet.device_z)
    records = backend.setup(positions, soup(len(sheet.xy)), sheet.resolution)
    spans = backend.spans(records)
    depth = stages.depth(records, spans, backend=backend.name)
    y, x, triangle = _places(records.triangle, spans)
    height, width = sheet.resolution
    key, wanted = (triangle * height + y) * width + x, (at.triangle * height + at.y) * width + at.x
    order = np.argsort(key, kind="stable")
    found = order[np.searchsorted(key[order], wanted)]
    assert np.array_equal(key[found], wanted)  # else coverage is wrong, and other cases say where
    return max(_ulps(got, exact) for got, exact in zip(depth[found].tolist(), at.exact, strict=True))


def _places(triangle: NDArray[np.int32], spans: NDArray[np.int32]) -> tuple[Points, Points, Points]:
    """y, x and triangle of every fragment of the spans, in their order."""
    lengths = (spans[:, 3] - spans[:, 2]).astype(np.int64)
    inside = np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    y, lower, index = (np.repeat(v.astype(np.int64), lengths) for v in (spans[:, 1], spans[:, 2], triangle[spans[:, 0]]))
    return y, lower + inside, index


def _too_far(build: Callable[[], Sheet], backend: Backend) -> int:
    """1 if an error is beyond the bound: 0.5 ulp, and 2^-39 absolute, which is 2^-15 ulp at depths of 0.5 to 1."""
    return int(worst(build, backend) > 0.5 + 2.0**-10)


def _naive_worst(build: Callable[[], Sheet]) -> dict[str, int]:
    """Worst error of each form, ulp, rounded up."""
    sheet, at = build(), _samples(build)
    result = dict.fromkeys(FORMS, 0.0)
    for t in np.unique(at.triangle).tolist():
        here = np.flatnonzero(at.triangle == t)
        x, y = at.x[here].astype(_F) + _F(0.5), at.y[here].astype(_F) + _F(0.5)
        for form in FORMS:
            got = naive_depth(form, sheet.xy[t], sheet.z[t], x, y)
            result[form] = max([result[form], *(_ulps(float(g), at.exact[i]) for g, i in zip(got, here, strict=True))])
    return {form: int(np.ceil(value)) for form, value in result.items()}


def _scene(name: str, count: int, width: int = 3840, height: int = 2160) -> Sheet:
    mesh = scenes.pixel_mesh(name, width, height)
    corners = mesh.vertices[mesh.triangles][-count:]
    return Sheet(np.floor(corners[..., :2] * SUBPX).astype(np.int64), f32(2 * corners[..., 2] - 1), (height, width))


def screen_filling() -> Sheet:
    """16 very large triangles at 1920 x 1080.
    The plane's terms are large where the depth is not."""
    return _scene("S3", 16, 1920, 1080)


def middle_sized() -> Sheet:
    """32 triangles of 4,000 to 40,000 px at 4K.
    Far from the origin, A x + B y and C cancel."""
    return _scene("S2", 32)


def slivers() -> Sheet:
    """40 slivers 1 to 2 px wide at 4K.
    The area is small, the slopes are large, and all terms cancel."""
    return _scene("S5", 40)


def small() -> Sheet:
    """200 triangles of 20 px, far from the origin.
    Steep slopes times large coordinates."""
    rng = np.random.default_rng(33)
    xy = px(rng.uniform(3300, 3800, (200, 1, 2)) * [1, 0.55] + rng.uniform(-5, 5, (200, 3, 2)))
    return Sheet(xy, f32(rng.uniform(-0.9, 0.9, (200, 3))), (2160, 3840), samples=5)


def thinnest() -> Sheet:
    """40 slivers up to 10,000 px long with an area of 1.5 square sub-pixels, around one pixel centre each.
    A plane's slopes cancel, even in float64; each pixel must be a weighted mean of the corners instead."""
    rng = np.random.default_rng(48)
    xy: list[Points] = []
    while len(xy) < 40:
        p, q = (int(v) for v in rng.integers(10**5, 10**6, 2))
        if np.gcd(p, q) == 1:
            # p s - q r = 1: with the corners c + (p, q), c + (r, s) and c - both, the area is 3 / 2 and c the centroid.
            r = -pow(q, -1, p)
            a, b = np.array([p, q]), np.array([r, (1 + q * r) // p])
            centre = rng.integers([0, 0], [1920, 1080]) * SUBPX + SUBPX // 2
            xy.append(np.stack([a, b, -a - b]) + centre)
    return Sheet(np.array(xy), f32(rng.uniform(-0.9, 0.9, (40, 3))), (1080, 1920))


# --- Depths that should be equal -----------------------------------------------------------------------------------------------


@lru_cache(maxsize=1)
def twice() -> tuple[Points, Float]:
    """The 30 triangles of H34, [30, 3, 2] subpx, and their normalized device depths [30, 3]."""
    rng = np.random.default_rng(34)
    return rng.integers(0, 600 * SUBPX, (30, 3, 2)), f32(rng.uniform(-0.9, 0.9, (30, 3)))


def _again(backend: Backend) -> int:
    xy, z = twice()
    turned = [1, 2, 0]
    before, after = (
        fragments(backend, clip_space(xy[:, o], (600, 600), z[:, o]), soup(30), (600, 600)) for o in ([0, 1, 2], turned)
    )
    return int((after < before).sum())


def _again_naive() -> dict[str, int]:
    xy, z = twice()
    return {form: sum(int((b < a).sum()) for a, b in map(partial(_both_depths, form), xy, z)) for form in FORMS}


def _both_depths(form: str, xy: Points, z: Float) -> tuple[Float, Float]:
    y, x = np.nonzero(covered(xy, (0, 0, 600, 600)))
    at = x.astype(_F) + _F(0.5), y.astype(_F) + _F(0.5)
    window = z * _F(0.5) + _F(0.5)
    return naive_depth(form, xy, window, *at), naive_depth(form, xy[[1, 2, 0]], window[[1, 2, 0]], *at)


def _coplanar() -> list[tuple[Points, Float]]:
    """A quad cut along one diagonal and along the other; its plane is a dyadic fraction, exact in float32 at every centre."""
    corners = np.array([[1510, 1507], [1711, 1547], [1690, 1707], [1491, 1667]]) * SUBPX
    corners += np.array([[37, 91], [5, 170], [201, 3], [99, 251]])
    z = ((corners @ np.array([5, 3]) - 2**22) / 2.0**23).astype(_F)  # 24 bits, at pixel centres too
    pairs = ([[0, 1, 2], [0, 2, 3]], [[0, 1, 3], [1, 2, 3]])
    return [(corners[np.array(pair)], z[np.array(pair)]) for pair in pairs]


def _diagonals(backend: Backend) -> int:
    size = (2048, 2048)
    images = [np.nanmin(fragments(backend, clip_space(xy, size, z), soup(2), size), axis=0, initial=2) for xy, z in _coplanar()]
    return int((images[0] != images[1]).sum())


def _diagonals_naive() -> dict[str, int]:
    result = {}
    for form in FORMS:
        images = []
        for xy, z in _coplanar():
            image = np.full((2048, 2048), 2, _F)
            for corners, depths in zip(xy, z, strict=True):
                y, x = np.nonzero(covered(corners, (0, 0, 2048, 2048)))
                window = depths * _F(0.5) + _F(0.5)
                image[y, x] = naive_depth(form, corners, window, x.astype(_F) + _F(0.5), y.astype(_F) + _F(0.5))
            images.append(image)
        result[form] = int((images[0] != images[1]).sum())
    return result


def _halfway(backend: Backend) -> int:
    """Pixels whose depth is not, in bits, what the specification's float64 operations give."""
    rng = np.random.default_rng(47)
    size, wrong = (512, 512), 0
    for _ in range(6):
        corners = 2 * rng.integers(0, 256 * SUBPX, (3, 2)) + [1, 0]
        # p x + q y + odd: even at these corners, 24 bits; odd at pixel centres, 25 bits: halfway between two float32.
        z = f32((corners @ (2 * rng.integers(-16, 16, 2) + 1) + 2**23 + 1) / 2.0**24)
        positions = clip_space(corners, size, z)
        records, _ = brute_force.records(positions, soup(1), *size)
        image = fragments(backend, positions, soup(1), size)[0]
        places = np.argwhere(~np.isnan(image))[::7].tolist()
        wrong += sum(brute_force.depth(records[0], x, y) != float(image[y, x]) for y, x in places)
    return wrong


def crossing() -> Sheet:
    """Two planes that cross in a line through the screen.
    Along the line the depths are nearly equal, and a rounding error decides which one is in front."""
    xy = px([[[-20, -30], [1500, -25], [-25, 1400]], [[-35, -20], [1400, -40], [-15, 1500]]])
    x, y = np.moveaxis(xy / SUBPX, -1, 0)
    z = 0.2 + 0.0003 * x - 0.0001 * y
    z[1] += 1e-8 * (x[1] - 250) + 1.5e-8 * (y[1] - 260)
    return Sheet(xy, f32(z), (512, 512))


@lru_cache(maxsize=1)
def _near_the_line() -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The pixels (x, y) near the crossing where the exact depths round to different float32, and which one is in front."""
    sheet = crossing()
    y, x = np.mgrid[:512, :512]
    rough = [naive_depth("barycentric", sheet.xy[t], sheet.z[t], x.astype(_F) + _F(0.5), y.astype(_F) + _F(0.5)) for t in (0, 1)]
    order = np.argsort(np.abs(rough[0] - rough[1]).ravel(), kind="stable")[:4000]
    places, winners = [], []
    for i in order.tolist():
        a, b = (exact_depth(sheet.xy[t], sheet.z[t], i % 512, i // 512) for t in (0, 1))
        if float(_F(float(a))) != float(_F(float(b))):  # else no float32 depth can tell them apart
            places.append((i % 512, i // 512))
            winners.append(int(b < a))
    return np.array(places), np.array(winners)


def _crossing(backend: Backend) -> int:
    sheet, (places, winners) = crossing(), _near_the_line()
    positions = clip_space(sheet.xy, sheet.resolution, sheet.device_z)
    drawn = np.asarray(backend.draw(positions, soup(2), sheet.resolution).triangle)
    return int((drawn[places[:, 1], places[:, 0]] != winners).sum())


def _crossing_naive() -> dict[str, int]:
    sheet, (places, winners) = crossing(), _near_the_line()
    x, y = places[:, 0].astype(_F) + _F(0.5), places[:, 1].astype(_F) + _F(0.5)
    depths = {form: [naive_depth(form, sheet.xy[t], sheet.z[t], x, y) for t in (0, 1)] for form in FORMS}
    return {form: int(((b < a) != winners).sum()) for form, (a, b) in depths.items()}


def _error_case(name: str, build: Callable[[], Sheet]) -> Case:
    title, _, reason = (build.__doc__ or "").partition("\n")
    wrong, plain = partial(_too_far, build), partial(_naive_worst, build)
    text = " ".join(reason.split())
    return Case(name, "depth", title.rstrip("."), "at most 0.5 ulp from the exact depth", text, wrong, plain, FORMS, "ulp")


ERRORS: dict[str, Callable[[], Sheet]] = {
    "H30": screen_filling,
    "H31": middle_sized,
    "H32": slivers,
    "H33": small,
    "H48": thinnest,
}
DEPTHS: list[Case] = [
    *(_error_case(name, build) for name, build in ERRORS.items()),
    Case(
        "H34",
        "depth",
        "30 triangles, and again with their vertices rotated",
        "no pixel is nearer the second time",
        "The same plane, computed from another vertex, rounds differently.",
        _again,
        _again_naive,
        FORMS,
    ),
    Case(
        "H35",
        "depth",
        "A quad cut along either diagonal, in a plane that float32 holds exactly",
        "the same depths, in bits",
        "Decals and shadows are drawn on such quads.",
        _diagonals,
        _diagonals_naive,
        ("origin",),
    ),
    Case(
        "H36",
        "depth",
        "Two planes that cross, 4000 px along the line",
        "the nearer one in front wherever float32 can tell",
        "The difference of the depths is smaller than their errors.",
        _crossing,
        _crossing_naive,
        ("origin", "v0"),
    ),
    Case(
        "H47",
        "depth",
        "Depths halfway between two float32, in six triangles over many cells",
        "the bits that docs/numerics.md gives",
        "Which way a tie is rounded depends on every operation, and on where the plane starts.",
        _halfway,
    ),
]
