"""H14 and H21 to H29: what must hold under clipping, under a change of the input, and for input that is no triangle."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from ..check import stages
from ..reference import brute_force
from . import naive
from .constructions import HALF, px
from .mesh import (
    SUBPX,
    Backend,
    Case,
    Mesh,
    bigtri_wrong,
    box_of,
    clip_space,
    coverage_by_triangle,
    covered,
    f32,
    naive_wrong,
    positive,
)

Points = NDArray[np.int64]
Positions = NDArray[np.float32]


def soup(count: int) -> NDArray[np.int32]:
    """Indices int32 [count, 3] of unconnected triangles."""
    return np.arange(3 * count, dtype=np.int32).reshape(-1, 3)


# --- Against the true projection ---------------------------------------------------------------------------------------------


def projected_case(name: str, family: str, build: Callable[[], tuple[Positions, tuple[int, int]]], breaks: str = "") -> Case:
    """A case of unconnected clip-space triangles, positions [3 T, 4], against rational homogeneous coverage."""
    title, _, reason = (build.__doc__ or "").partition("\n")
    invariant = "covers as rational arithmetic says, but for centres within 1/256 px of an edge"
    wrong, plain = partial(_projected_wrong, build), partial(_projected_naive, build)
    return Case(name, family, title.rstrip("."), invariant, " ".join(reason.split()), wrong, plain, tuple(breaks.split()))


@lru_cache(maxsize=2)
def true_sides(build: Callable[[], tuple[Positions, tuple[int, int]]]) -> NDArray[np.int8]:
    """int8 [T, H, W]: 1 inside, -1 outside, 0 too near to an edge to tell; fractions, neither clipped nor snapped."""
    positions, (height, width) = build()
    sides = np.empty((len(positions) // 3, height, width), np.int8)
    for t, corners in enumerate(positions.reshape(-1, 3, 4).tolist()):
        lines = brute_force.outline([tuple(c) for c in corners], height, width)
        for y, x in np.ndindex(height, width):
            sides[t, y, x] = brute_force.true_side(lines, x, y)
    return sides


def _projected_wrong(build: Callable[[], tuple[Positions, tuple[int, int]]], backend: Backend) -> int:
    positions, (height, width) = build()
    sides = true_sides(build)
    records = backend.setup(positions, soup(len(sides)), (height, width))
    drawn = coverage_by_triangle(records, backend.spans(records), len(sides))
    wrong = 0
    for t, side in enumerate(sides):
        mask, elsewhere = drawn(t, (0, 0, width, height))
        image = np.asarray(backend.draw(positions[3 * t : 3 * t + 3], soup(1), (height, width)).triangle) >= 0
        wrong += elsewhere + int((mask != image).sum()) + int((mask & (side < 0)).sum() + (~mask & (side > 0)).sum())
    return wrong


def _projected_naive(build: Callable[[], tuple[Positions, tuple[int, int]]]) -> dict[str, int]:
    """Divided by w without clipping, then each variant; in float32 px."""
    positions, (height, width) = build()
    wrong = dict.fromkeys(naive.VARIANTS, 0)
    with np.errstate(all="ignore"):
        middle = f32([width / 2, height / 2])
        screen = positions[:, :2] / positions[:, 3:] * middle * f32([1, -1]) + middle
        for corners, side in zip((screen.astype(np.float64) * SUBPX).reshape(-1, 3, 2), true_sides(build), strict=True):
            area = np.linalg.det(corners[1:] - corners[0])
            turned = corners if area >= 0 else corners[[0, 2, 1]]
            for variant in wrong:
                got = naive.coverage(variant, turned, (0, 0, width, height))  # type: ignore[arg-type]
                wrong[variant] += int((got & (side < 0)).sum() + (~got & (side > 0)).sum())
    return wrong


def astronomic() -> tuple[Positions, tuple[int, int]]:
    """Vertices at +-1e20 in clip space.
    Products overflow float32: infinity minus infinity is NaN, and NaN is inside of nothing."""
    far = 1e20
    corners = [[-far, -far, 0, 1], [far, -far, 0, 1], [0, far, 0, 1], [-far, 0.1, 0, 1], [far, -0.2, 0, 1], [0.3, far, 0, 1]]
    corners += [[-far, -far, 0, 1], [far, far, 0, 1], [far, 0.9 * far, 0, 1]]
    return np.array(corners, np.float32), (64, 64)


def behind_the_camera() -> tuple[Positions, tuple[int, int]]:
    """20 triangles with one vertex behind the camera (w < 0).
    Divided by a negative w, the vertex appears on the wrong side; the triangle must be clipped first."""
    rng = np.random.default_rng(26)
    corners = rng.uniform(-1, 1, (20, 3, 4)) * [2, 2, 0, 0]
    corners[..., 2] = -rng.uniform(0.1, 0.3, (20, 3))  # negative: never beyond the far plane, where depth would drop fragments
    corners[..., 3] = rng.uniform(0.5, 1.5, (20, 3))
    corners[:, 0, 3] = -rng.uniform(0.1, 1, 20)
    return corners.reshape(-1, 4).astype(np.float32), (48, 48)


# --- Invariances -------------------------------------------------------------------------------------------------------------


@lru_cache(maxsize=1)
def tie_triangles() -> Points:
    """[80, 3, 2], subpx, within 1024 px: the first 60 with an edge through pixel centres. All coordinates are even."""
    rng = np.random.default_rng(21)
    xy = 2 * rng.integers(0, 512 * SUBPX, (80, 3, 2))
    for t in range(60):
        p, q = ((1, 1), (2, 1), (1, 3), (3, 2), (5, 3), (7, 4))[t % 6]
        centre = rng.integers(400, 600, 2) * SUBPX + HALF
        step = np.array([p, q if t % 2 else -q])
        xy[t, 0], xy[t, 1] = centre - step * 2 * rng.integers(4000, 7000), centre + step * 2 * rng.integers(4000, 7000)
    return xy


def _naive_same(change: Callable[[Points], Points], shift: tuple[int, int] = (0, 0)) -> dict[str, int]:
    """Pixels that a change of the input changes in half of the triangles; the changed ones are shifted by ``shift`` px."""
    wrong = dict.fromkeys((*naive.VARIANTS, "fixed4"), 0)
    for xy in tie_triangles()[::2]:
        x0, y0, x1, y1 = box = box_of(xy, (1024, 1024))
        moved = (x0 + shift[0], y0 + shift[1], x1 + shift[0], y1 + shift[1])
        other = change(xy)
        for name in naive.VARIANTS:
            before, after = naive.coverage(name, positive(xy), box), naive.coverage(name, positive(other), moved)
            wrong[name] += int(np.count_nonzero(before != after))
        wrong["fixed4"] += int((covered(naive.fixed4(xy), box) != covered(naive.fixed4(other), moved)).sum())
    return wrong


def _deep(xy: Points, resolution: tuple[int, int]) -> Positions:
    """With the same random depths whatever the positions: 12 bits, so that clip space holds them exactly."""
    z = np.random.default_rng(22).integers(-2000, 2000, xy.shape[:2]) / 2048
    return clip_space(xy, resolution, z)


def _translated(backend: Backend) -> int:
    resolution, count = (2048, 4096), len(tie_triangles())
    shift = np.array([2048, 1024])
    before = backend.draw(_deep(tie_triangles(), resolution), soup(count), resolution).packed
    after = backend.draw(_deep(tie_triangles() + shift * SUBPX, resolution), soup(count), resolution).packed
    expected = np.full_like(before, 2**63 - 1)
    expected[1024:, 2048:] = before[:1024, :2048]
    return int(np.count_nonzero(after != expected))


def _reordered(order: tuple[int, int, int], backend: Backend) -> int:
    positions = _deep(tie_triangles(), (1024, 1024))
    triangles = soup(len(tie_triangles()))
    before, after = (backend.draw(positions, t, (1024, 1024)).packed for t in (triangles, triangles[:, order]))
    return int(np.count_nonzero(before != after))


def midpoints() -> list[Mesh]:
    """Triangles with an edge through centres, each cut at its edges' midpoints into four.
    A T-junction without a crack: what the parts cover is what the whole covers, each pixel once."""
    meshes = []
    for xy in tie_triangles()[:60:6]:
        middle = (xy + np.roll(xy, -1, axis=0)) // 2  # of edges 01, 12, 20
        parts = [[xy[k], middle[k], middle[k - 1]] for k in range(3)] + [[middle[0], middle[1], middle[2]]]
        # Half the size in px; all coordinates stay integers because the edges are even.
        whole = np.zeros((1024, 1024), np.bool_)
        x0, y0, x1, y1 = box = box_of(xy, (1024, 1024))
        whole[y0:y1, x0:x1] = covered(xy, box)
        meshes.append(Mesh(np.array(parts), (1024, 1024), whole))
    return meshes


# --- Clipped edges -----------------------------------------------------------------------------------------------------------


def _cut_edges() -> NDArray[np.float64]:
    """[1000, 4, 4]: P behind the near plane; Q, and R and S on either side of PQ, before it."""
    rng = np.random.default_rng(25)
    scale = 10.0 ** rng.uniform(-2, 2, (1000, 1, 1))
    corners = rng.uniform(-1, 1, (1000, 4, 4)) * [1, 1, 1, 0] * scale
    corners[..., 3] = rng.uniform(0.5, 1.5, (1000, 4)) * scale[..., 0]
    corners[:, 0, 2] = -corners[:, 0, 3] * rng.uniform(1.01, 3, 1000)
    corners[:, 1:, 2] = corners[:, 1:, 3] * rng.uniform(-0.9, 0.9, (1000, 3))
    corners[..., :2] *= 0.3
    return corners.astype(np.float32).astype(np.float64)


def _clipped_edges(backend: Backend) -> int:
    """Edges PQ whose new vertex differs between the triangles PQR and QPS, where it is snapped and in its w."""
    corners = _cut_edges()
    positions = corners.reshape(-1, 4).astype(np.float32)
    first = 4 * np.arange(len(corners))[:, None]
    triangles = np.concatenate([first + [0, 1, 2], first + [1, 0, 3]]).astype(np.int32)
    records = backend.setup(positions, triangles, (2048, 2048))
    ends: list[set[tuple[float, ...]]] = [set() for _ in triangles]
    for record, triangle in enumerate(records.triangle.tolist()):
        corners_of = zip(records.xy[record].tolist(), records.z[record].tolist(), records.w[record].tolist(), strict=True)
        ends[triangle] |= {(*xy, z, w) for xy, z, w in corners_of}
    pairs = zip(ends[: len(corners)], ends[len(corners) :], strict=True)
    # Q and the new vertex are common to both. A triangle seen edge-on has no record, and so no vertex to compare.
    wrong = sum(1 for a, b in pairs if a and b and len(a & b) < 2)
    # The two new vertices lie on the near plane: depth 0, not a rounding error before or behind it.
    return wrong + sum(1 for vertices in ends if vertices and sum(z == 0 for *_, z, _ in vertices) != 2)


def _many_planes(backend: Backend) -> int:
    """Record fields that differ in bits from the scalar oracle's, of triangles cut by near and by guard planes at once."""
    rng = np.random.default_rng(49)
    corners = rng.normal(size=(300, 3, 4)) * [1, 1, 1, 0]
    corners[..., :2] *= 10.0 ** rng.uniform(0, 6, (300, 3, 1))
    corners[..., 3] = rng.uniform(-0.5, 1.5, (300, 3))
    positions = corners.reshape(-1, 4).astype(np.float32)
    records = backend.setup(positions, soup(300), (200, 300))
    expected, _ = brute_force.records(positions, soup(300), 200, 300)
    wrong = abs(len(expected) - len(records.triangle)) + (len(expected) < 100)
    for name in ("triangle", "xy", "z", "w", "weights"):
        fields = zip(getattr(records, name), (np.asarray(getattr(e, name)) for e in expected), strict=False)
        wrong += sum(not np.array_equal(got, want) for got, want in fields)
    return wrong


def _clipped_edges_naive() -> dict[str, int]:
    """Edges whose new vertex differs when the clipper walks them the other way: float32, a + (b - a) * t."""
    f = np.float32
    p, q = (_cut_edges()[:, k].astype(f) for k in (0, 1))
    dp, dq = p[:, 2] + p[:, 3], q[:, 2] + q[:, 3]
    there = p + (q - p) * (dp / (dp - dq))[:, None]
    back = q + (p - q) * (dq / (dq - dp))[:, None]
    return {"f32": int((there != back).any(axis=1).sum())}


# --- What is no triangle -----------------------------------------------------------------------------------------------------


def _not_finite(backend: Backend) -> int:
    resolution = (64, 64)
    xy = np.random.default_rng(27).integers(0, 64 * SUBPX, (30, 3, 2))
    positions = _deep(xy, resolution)
    good = np.arange(30) % 3 == 0
    bad = [np.nan, np.inf, -np.inf]
    for t in np.flatnonzero(~good):
        positions[3 * t + t % 3, t % 4] = bad[t % 3]
    drawn = backend.draw(positions, soup(30), resolution)
    alone = backend.draw(positions, np.where(good[:, None], soup(30), 0), resolution)
    return int((np.asarray(drawn.packed) != alone.packed).sum()) + abs(int(drawn.dropped) - int((~good).sum()))


def _keys(backend: Backend) -> int:
    """Depths that are hard to order, as bits: the depth stage must not store -0, and the smallest must win."""
    positions = clip_space(px([[[-5, -5], [40, -5], [-5, 40]]]), (16, 16))
    records = backend.setup(np.tile(positions, (5, 1)), soup(5), (16, 16))
    values = np.array([-0.0, 1e-45, 1e-38, 0.5, 1.0], np.float32)
    wrong = 0
    for turn in range(5):
        z = np.roll(values, turn)
        deep = records._replace(z=np.repeat(z[:, None], 3, axis=1))
        spans = backend.spans(deep)
        depth = stages.depth(deep, spans, backend=backend.name)
        wrong += int(np.signbit(depth).sum())
        packed = stages.visibility(deep, spans, depth, 16, 16, backend=backend.name)
        wrong += int(((packed & 0xFFFFFFFF) != turn).sum() + ((packed >> 32) != 0).sum())
    return wrong


_INDICES = (2**24 - 1, 2**24 + 1, 2**24 + 3, 2**31 - 1)


def _large_ids(backend: Backend) -> int:
    """Triangle indices around 2^24, where float32 skips every other one, and the last int32."""
    positions = clip_space(px([[[-5, -5], [40, -5], [-5, 40]]]), (16, 16))
    records = backend.setup(positions, soup(1), (16, 16))
    spans = backend.spans(records)
    depth = stages.depth(records, spans, backend=backend.name)
    wrong = 0
    for index in _INDICES:
        named = records._replace(triangle=np.full(1, index, np.int32))
        packed = stages.visibility(named, spans, depth, 16, 16, backend=backend.name)
        wrong += int(((packed & 0xFFFFFFFF) != index).sum())
    return wrong


RULES: list[Case] = [
    projected_case("H14", "far", astronomic, "incl strict tl plane third step"),
    Case(
        "H21",
        "invariance",
        "80 triangles moved by (2048, 1024) px",
        "a shift of the image, in bits",
        "Coordinates that grow lose bits that they had.",
        _translated,
        partial(_naive_same, lambda xy: xy + np.array([2048, 1024]) * SUBPX, (2048, 1024)),
        ("plane",),
    ),
    Case(
        "H22",
        "invariance",
        "80 triangles, vertices in the order 1, 2, 0",
        "the same image, in bits",
        "A method that treats one vertex differently lets the order decide.",
        partial(_reordered, (1, 2, 0)),
        partial(_naive_same, lambda xy: xy[[1, 2, 0]]),
        ("third",),
    ),
    Case(
        "H23",
        "invariance",
        "80 triangles, vertices in the order 0, 2, 1",
        "the same image, in bits",
        "Both faces are drawn, so the winding must not matter.",
        partial(_reordered, (0, 2, 1)),
        partial(_naive_same, lambda xy: xy[[0, 2, 1]]),
    ),
    Case(
        "H24",
        "ties",
        "10 triangles cut at the midpoints of their edges",
        "the four parts are the whole, each pixel once",
        "The inner edges pass through pixel centres with other end points than the outer ones.",
        partial(bigtri_wrong, midpoints),
        partial(naive_wrong, midpoints),
        ("incl", "strict", "fma", "third"),
    ),
    Case(
        "H25",
        "clipping",
        "1000 edges cut by the near plane, seen from both sides",
        "the new vertices are equal in bits, at depth 0",
        "Neighbours walk a common edge in opposite directions; an interpolation rounds differently each way.",
        _clipped_edges,
        _clipped_edges_naive,
        ("f32",),
        "edges",
    ),
    projected_case("H26", "clipping", behind_the_camera, "incl strict tl fma plane third step"),
    Case(
        "H27",
        "input",
        "NaN and infinities in 20 of 30 triangles",
        "these are dropped and counted, the others as if alone",
        "A NaN converted to an integer is anything, often the smallest one there is.",
        _not_finite,
    ),
    Case(
        "H28",
        "depth",
        "Depths -0, 1e-45, 1e-38, 0.5 and 1 in every order",
        "the smallest wins; -0 is 0",
        "As bits, -0 is behind everything; flushed to zero, denormals are all equal.",
        _keys,
    ),
    Case(
        "H29",
        "input",
        "Triangle indices around 2^24 and 2^31",
        "each comes back as it was",
        "Stored as a float32, 16777217 becomes 16777216. Reported as nvdiffrast issue 136.",
        _large_ids,
        lambda: {"f32": sum(int(np.float32(i)) != i for i in _INDICES)},
        ("f32",),
        "indices",
    ),
    Case(
        "H49",
        "clipping",
        "300 triangles cut by the near plane and by guard planes at once",
        "equals the scalar oracle in bits",
        "A vertex made by two planes must lie on both: exactly at depth 0, exactly at the end of the guard band.",
        _many_planes,
        unit="fields",
    ),
]
