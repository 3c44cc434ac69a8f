"""The CUDA kernels without a GPU, in bits: every variant, case and way through them, run by cuda_on_cpu.py."""

from __future__ import annotations

import ctypes
import functools
import importlib
import itertools
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

import counted_work
import cuda_on_cpu
import numpy as np
import pytest
import torch
from cases import CASES, Case, from_pixels, random_corners, soup
from cuda_bits import CONSTRUCTIONS, EVERY, PATHS, VALUES, that_differ, values_of
from cuda_on_cpu import TOGETHER, VARIANTS, Job
from exhaustive import exhaustive
from numpy.typing import NDArray

import bigtri
from bigtri import native, reference
from bigtri.check.work_map import WorkMap, map_work
from bigtri.ops.rasterize import CULLS
from bigtri.precision import EXACT
from bigtri.reference.numerics import edges_of, stepped_values
from bigtri.reference.records import Records
from bigtri.reference.work import record_bytes, without_empty

pytestmark = [
    pytest.mark.skipif(bool(cuda_on_cpu.available()), reason=cuda_on_cpu.available()),
    pytest.mark.skipif(not native.available(), reason="the extension is not built"),
    pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning"),
]

BENCH = Path(__file__).parents[2] / "bench"
PIXELS = 150_000  # of cases that are not too large
# Ways through the kernels, and with them every value of those parameters that choose one.
WAYS = ({"few": 65536}, {"few": 64}, {"few": 0})
ODD = (
    "behind_camera",
    "guard_band",
    "crowded",
    "clipped_fans",
    "hundreds_in_a_bin",
    "hundreds_in_a_list",
    "long_slivers",
    "slivers_across",
    "small_on_cells",
    "mixed",
)


@functools.cache
def case_of(name: str) -> Case:
    return CONSTRUCTIONS[name](np.random.default_rng([0, *name.encode()]))


def job(
    case: Case,
    variant: str,
    settings: dict[str, int],
    triangles: np.ndarray | None = None,
    dropped: int | None = None,
    cull: str = "none",
    scissor: tuple[int, int, int, int] | None = None,
) -> Job:
    """triangles, dropped: what the kernels get and count, where the CPU would refuse it."""
    tensors = torch.from_numpy(case.positions), torch.from_numpy(case.triangles)
    seen = bigtri.rasterize(*tensors, case.resolution, cull=cull, scissor=scissor, backend="native")
    assert seen.depth is not None
    given = case if triangles is None else case._replace(triangles=triangles)
    count = int(seen.dropped) if dropped is None else dropped
    return Job(given, seen.packed.numpy(), seen.depth.numpy(), count, variant, settings, cull, scissor)


def assert_right(jobs: list[Job], first: int = 0, library: ctypes.CDLL | None = None) -> None:
    """first: the number of the first job, which chooses orders of threads. library: of the kernels, where not the usual ones."""
    said = cuda_on_cpu.differences_in_children(library or cuda_on_cpu.kernels(), jobs, first)
    assert not said, said


def read_by(variant: str) -> dict[str, tuple[int, ...]]:
    """Values for its parameters; not for the blocks of one of `TOGETHER`, of which there is always one here."""
    known = cuda_on_cpu.parameters(cuda_on_cpu.kernels(), variant)
    return {name: values_of(p) for name, p in known.items() if not (variant in TOGETHER and name == "blocks")}


def as_read(variant: str, settings: Iterable[dict[str, int]]) -> list[dict[str, int]]:
    """Of settings such as differ for the variant."""
    return that_differ(read_by(variant), settings)


def covering(variant: str, rng: np.random.Generator) -> list[dict[str, int]]:
    """Settings in which each value of each one that the variant reads is there with each way through it."""
    rows = []
    for way in as_read(variant, WAYS):
        free = {field: values for field, values in read_by(variant).items() if field not in WAYS[-1]}
        most = max(map(len, free.values()), default=1)
        columns = {field: rng.permutation(np.resize(values, most)) for field, values in free.items()}
        rows += [{**way, **{field: int(column[n]) for field, column in columns.items()}} for n in range(most)]
    return rows


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("name", CASES)
def test_every_case(name: str, variant: str) -> None:
    case = case_of(name)
    if np.prod(case.resolution) > PIXELS:
        pytest.skip("large")
    assert_right([job(case, variant, s) for s in as_read(variant, PATHS.values())], list(CASES).index(name))


@pytest.mark.parametrize("name", [*CASES, "mixed"])
def test_every_case_where_float64_is_slow(name: str) -> None:
    """A case in three of the ways through the kernels, each way with many cases."""
    case = case_of(name)
    if np.prod(case.resolution) > PIXELS:
        pytest.skip("large")
    number = [*CASES, "mixed"].index(name)
    ways = as_read("bin_owned", [way for turn, way in enumerate(PATHS.values()) if turn % 3 == number % 3])
    assert_right([job(case, "bin_owned", s) for s in ways], number, cuda_on_cpu.kernels_where_float64_is_slow())


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("name", ["corner_of_huge", "layers", "long_slivers", "small_by_the_screen", "clipped_fans"])
def test_culling_and_scissor(name: str, variant: str) -> None:
    case = case_of(name)
    height, width = case.resolution
    boxes = (None, (3, 5, width - 2, height - 9), (63, 1, 66, height), (-7, -7, 5, 5), (9, 9, 9, 20))
    how = list(zip([*CULLS, *CULLS], boxes, strict=False))
    assert_right([job(case, variant, s, cull=c, scissor=b) for s in as_read(variant, PATHS.values()) for c, b in how])


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("name", ODD)
def test_launch_settings_change_no_bit(name: str, variant: str) -> None:
    rows = covering(variant, np.random.default_rng(list(name.encode())))
    assert_right([job(case_of(name), variant, settings) for settings in rows])


@exhaustive
@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("name", ODD)
def test_many_launch_settings_change_no_bit(name: str, variant: str) -> None:
    """Any settings together, and each one alone."""
    rng = np.random.default_rng(list(name.encode()))
    own = read_by(variant)
    drawn = [{field: int(rng.choice(values)) for field, values in own.items()} for _ in range(24)]
    alone = [{field: value} for field, values in own.items() for value in values]
    assert_right([job(case_of(name), variant, settings) for settings in as_read(variant, (*drawn, *alone))])


def test_every_setting_is_tried() -> None:
    library = cuda_on_cpu.kernels()
    known = [p for variant in VARIANTS for p in cuda_on_cpu.parameters(library, variant).values()]
    assert {*VALUES} <= {p.name for p in known}
    assert all(p.low <= value <= p.high for p in known for value in values_of(p))
    for variant in VARIANTS:
        rows = covering(variant, np.random.default_rng(0))
        for way in as_read(variant, WAYS):
            there = [row for row in rows if way.items() <= row.items()]
            for field, values in read_by(variant).items():
                if field not in WAYS[-1]:
                    assert {row[field] for row in there} == set(values), (variant, way, field)
    for p in known:
        assert {way[p.name] for way in WAYS if p.name in way} <= {*values_of(p)}, p.name


@pytest.mark.parametrize("variant", ["bin_owned", "two_stage"])
def test_triangles_in_turns(variant: str) -> None:
    """As many as all blocks take in a turn, 512 here, one more, and less; several turns, of which the last is not full. All are
    drawn, and each that is dropped is counted once."""
    rng = np.random.default_rng(11)
    corners = random_corners(rng, 2657, 0.9)
    corners[:, 1:] = corners[:, :1] + rng.normal(0, 0.05, (len(corners), 2, 4)) * [1, 1, 0, 0]
    corners[::37, 1, 2] = np.nan
    counts = (1, 127, 512, 513, 1600, 2657)
    cases = [soup(corners[:count], (70, 90)) for count in counts]
    # Of so many for the image that few show, or nearly all: the first half are large, and warps go over to the others.
    corners = corners.copy()
    corners[: len(corners) // 2, 1:, :2] += rng.normal(0, 0.5, (len(corners) // 2, 2, 2))
    corners[len(corners) // 2 :, 1:, :2] = corners[len(corners) // 2 :, :1, :2] + 1e-3
    cases += [soup(corners[:count], (9, 11)) for count in counts]
    # Of 256 triangles, evenly spread, three quarters or more show: so all are drawn untested, and blocks claim 128 at a time. The
    # last 1,024 are nearest, so that what is left out is seen; of each 31 one is dropped, so that what is drawn twice is counted;
    # of each 53 one has to be clipped. Then others of which a third or a fifth are hidden; and the sample alone, or all else.
    corners = random_corners(rng, 8300, 0.5)
    corners[:, :, 2] = rng.uniform(0, 0.9, (len(corners), 1)) * corners[:, :, 3]
    corners[5::53, 2, 2:] = -0.1, -0.05
    place = np.arange(len(corners))
    sampled = np.isin(place, 4096 * np.arange(256) // 256)
    for count, out in [(count, None) for count in (*range(2049, 2561, 127), 3700, 8300)] + [
        (4096, out) for out in (place // 32 % 3 == 1, place // 32 % 5 == 1, sampled, ~sampled)
    ]:
        near = corners.copy()
        near[count - 1024 : count, :2, 2] *= -1
        near[::31, 1, 2] = np.nan
        if out is not None:
            near[out, 1:] = near[out, :1] + 1e-3
        cases.append(soup(near[:count], (9, 11)))
    assert_right([job(case, variant, PATHS["tested"]) for case in cases])


@pytest.mark.parametrize("variant", VARIANTS)
def test_views_of_one_mesh(variant: str) -> None:
    """Each view is drawn as if it were alone, whatever the one before it has left in the scratch memory."""
    case = case_of("mixed")
    views = case.positions * np.array([[[1, 1, 1, 1]], [[-1, 0.5, 1, 1]], [[0.1, 0.1, 1, 1]]], np.float32)
    for settings in as_read(variant, (*PATHS.values(), {"few": 0, "share": 4})):
        alone = [job(case._replace(positions=positions), variant, settings) for positions in views]
        packed, depth = np.stack([view.packed for view in alone]), np.stack([view.depth for view in alone])
        dropped = np.array([view.dropped for view in alone])
        assert_right([Job(case._replace(positions=views), packed, depth, dropped, variant, settings)])


@pytest.mark.parametrize("variant", VARIANTS)
def test_ranges_of_one_list(variant: str) -> None:
    """More views than a launch can carry ranges of, and than a warp can look at in one step; some of them empty.

    Of an odd number of pixels, so that every second one begins between two places of 16 bytes.
    """
    case = case_of("mixed")._replace(resolution=(19, 25))
    rng = np.random.default_rng(5)
    first = rng.integers(0, len(case.triangles), 1100)
    count = np.minimum(rng.integers(0, 9, 1100) * rng.integers(0, 40, 1100), len(case.triangles) - first)
    ranges = np.stack([first, count], axis=1).astype(np.int32)
    tensors = torch.from_numpy(case.positions), torch.from_numpy(case.triangles)
    # Two launches and two steps of a warp already take 300 views.
    for views, settings in ((1100, {}), (300, {"share": 4}), (300, {"share": 4, "team": 4}), (300, {"share": 1024})):
        seen = bigtri.rasterize(*tensors, case.resolution, ranges=torch.from_numpy(ranges[:views]))
        assert seen.depth is not None
        pictures = seen.packed.numpy(), seen.depth.numpy(), seen.dropped.numpy()
        assert_right([Job(case, *pictures, variant, settings, ranges=ranges[:views])])


@pytest.mark.parametrize("variant", VARIANTS)
def test_one_crowded_view_of_many(variant: str) -> None:
    """It has enough triangles for its pixels that vertices are projected once, which takes memory; all together have not."""
    case = case_of("mesh_of_small")
    count, pixels = len(case.triangles), int(np.prod(case.resolution))
    assert len(case.positions) <= 2 * count and 64 * count >= pixels
    ranges = np.zeros((64 * count // pixels + 2, 2), np.int32)
    ranges[1] = 0, count
    tensors = torch.from_numpy(case.positions), torch.from_numpy(case.triangles)
    seen = bigtri.rasterize(*tensors, case.resolution, ranges=torch.from_numpy(ranges))
    assert seen.depth is not None
    pictures = seen.packed.numpy(), seen.depth.numpy(), seen.dropped.numpy()
    assert_right([Job(case, *pictures, variant, {}, ranges=ranges)])


@pytest.mark.parametrize("variant", VARIANTS)
def test_an_index_out_of_range_is_dropped_and_counted(variant: str) -> None:
    case = case_of("mixed")
    indices = np.resize([-1, len(case.positions), 2**31 - 1, -(2**31)], 24)
    which = np.random.default_rng(1).permutation(len(case.triangles))[: len(indices)]
    without, wrong = case.triangles.copy(), case.triangles.copy()
    without[which] = 0  # of no area
    wrong[which, np.arange(len(indices)) // 4 % 3] = indices  # each one at each corner
    finite = np.isfinite(case.positions[case.triangles]).all(axis=(1, 2))
    dropped = int((~finite).sum() + finite[which].sum())
    paths, seen = as_read(variant, (*PATHS.values(), {"few": 0, "share": 4})), case._replace(triangles=without)
    assert_right([job(seen, variant, s, triangles=wrong, dropped=dropped) for s in paths])


def test_frames_that_launch_the_same_kernels() -> None:
    """The first one's are launched one by one, later ones by one of four graphs, of which only what differs is set."""
    library = cuda_on_cpu.kernels()
    jobs = [
        job(case_of(name), "bin_owned", {"few": 0, "share": share})
        for share in (8, 128)
        for name in ("mixed", "crowded", "clipped_fans")
    ]

    def graphs() -> list[str]:
        found = []
        kept = [cuda_on_cpu.outputs_of(one) for one in jobs]  # a job's frames are the same only if their memory is

        def draw(number: int, launched: int, made: int, *nodes: int) -> None:
            before = library.set_nodes()
            for output in kept[number]:
                output.view(np.uint8).fill(0x7F)
            packed, depth, _ = cuda_on_cpu.draw(library, jobs[number], outputs=kept[number])
            same = (packed == jobs[number].packed).all() and (depth.view("i4") == jobs[number].depth.view("i4")).all()
            counts = library.launched_graphs(), library.made_graphs(), library.set_nodes() - before
            if not same or counts[:2] != (launched, made) or counts[2] not in nodes:
                found.append(f"job {number}: {same}, {counts} instead of {launched, made, nodes}")

        draw(0, 0, 0, 0)
        draw(1, 1, 1, 0)
        draw(2, 2, 2, 0)
        draw(2, 3, 2, 0)
        draw(3, 3, 2, 0)
        draw(0, 4, 3, 0)
        draw(4, 5, 4, 0)
        draw(1, 6, 4, 0)
        return found

    said = cuda_on_cpu.in_children([graphs])
    assert not said, said


def one_triangle() -> Case:
    """In a small image, for what is drawn many times."""
    return soup(np.array([[(-0.9, -0.8, 0.2, 1), (0.9, -0.8, 0.2, 1), (0, 0.9, 0.2, 1)]]), (12, 16))


def test_a_graph_that_was_refused_is_tried_again() -> None:
    """After 64 frames, then after 128; these go without one, and all are drawn."""
    library, drawn = cuda_on_cpu.kernels(), job(one_triangle(), "bin_owned", {"few": 0, "share": 8})

    def refusals() -> list[str]:
        library.refuse_graphs(2)
        refused, launched = [], []
        for frame in range(2 + 64 + 1 + 128 + 2):
            to_refuse, before = library.graphs_to_refuse(), library.launched_graphs()
            if not np.array_equal(cuda_on_cpu.draw(library, drawn)[0], drawn.packed):
                return [f"frame {frame} is wrong"]
            if library.graphs_to_refuse() < to_refuse:
                refused.append(frame)
            if library.launched_graphs() > before:
                launched.append(frame)
        right = refused == [1, 1 + 64 + 1] and launched == [66 + 128 + 1, 196]
        return [] if right else [f"refused {refused}, launched {launched}"]

    said = cuda_on_cpu.in_children([refusals])
    assert not said, said


def test_shared_memory_is_allowed_once() -> None:
    """Of a kernel whose blocks have more than 48 KB of it."""
    library = cuda_on_cpu.kernels()
    jobs = [job(one_triangle(), "scanline", {"threads": threads}) for threads in (128, 512, 512, 128)]

    def allowed() -> list[str]:
        found = []
        for drawn in jobs:
            cuda_on_cpu.draw(library, drawn)
            found.append(library.times_allowed())
        return [] if found == [0, 1, 1, 1] else [f"allowed {found} times"]

    said = cuda_on_cpu.in_children([allowed])
    assert not said, said


@pytest.mark.parametrize("variant", VARIANTS)
def test_nothing_to_draw(variant: str) -> None:
    none = Case(np.zeros((0, 4), np.float32), np.zeros((0, 3), np.int32), (70, 131))
    indices = np.zeros((1000, 3), np.int32)
    given: tuple[dict[str, Any], ...] = ({}, {"triangles": indices, "dropped": 1000})
    assert_right([job(none, variant, s, **what) for s in as_read(variant, PATHS.values()) for what in given])


@pytest.mark.parametrize(
    ("file", "old", "new", "said"),
    [
        ("region.cuh", "at[k] += step[k];", "at[k] += 2 * step[k];", "values differ"),
        ("persistent.cu", "pixels[kBin * kBin];", "pixels[kBin * kTile];", "cuda_on_cpu: "),
        ("patch.cuh", "if (k == 0) {", "if (k == 0) { __syncthreads();", "cuda_on_cpu: "),
        ("bin_owned.cu", "blockIdx.x);\n  __syncthreads();\n  Fate", "blockIdx.x);\n  Fate", "values differ"),
        ("sliver.cuh", "more = s->count > 0;\n      __syncthreads();", "more = s->count > 0;", "values differ"),
    ],
)
def test_what_is_broken_shows(file: str, old: str, new: str, said: str, tmp_path: Path) -> None:
    """A formula, memory, a barrier that not all reach, one that is not there, what one warp reads after another has gone on."""
    library = cuda_on_cpu.build(tmp_path / "build", (file, old, new))
    drawn = [
        ("mixed", "bin_owned", 1),
        ("mixed", "persistent", 1),
        ("layers", "bin_owned", 1),
        ("long_slivers", "bin_owned", 700),
    ]
    # Of any number of triangles, so that all paths draw.
    few = {"bin_owned": {"few": EVERY}, "persistent": {}}
    jobs = [job(case_of(name), variant, {"queue": queue, **few[variant]}) for name, variant, queue in drawn]
    assert said in cuda_on_cpu.differences_in_children(library, jobs)


def squares(records: Records, size: int, by_edges: bool = True) -> NDArray[np.int64]:
    """How many squares of size x size px each record's bounding box meets, less those that an edge rejects."""
    x0, y0, x1, y1 = records.bbox.T.astype(np.int64)
    across, down = (x1 - 1) // size - x0 // size + 1, (y1 - 1) // size - y0 // size + 1
    record = np.repeat(np.arange(len(across)), across * down)
    place = np.arange(len(record)) - np.repeat(np.cumsum(across * down) - across * down, across * down)
    left, top = size * (x0[record] // size + place % across[record]), size * (y0[record] // size + place // across[record])
    corners = [(left + i, top + j) for i in (0, size - 1) for j in (0, size - 1)]
    highest = np.max([stepped_values(edges_of(records.xy[record]), x, y) for x, y in corners], axis=0)
    kept = (highest >= 0).all(axis=1) if by_edges else np.ones(len(record), bool)
    return np.bincount(record[kept], minlength=len(across))


def pyramid_entries(records: Records) -> NDArray[np.int64]:
    """Tiles of each record at the level where hierarchical_tiles stores it, by its standard parameters."""
    sizes = [16 << level for level in range(11)]
    met = np.stack([squares(records, size, by_edges=False) for size in sizes])
    level = (met <= 4).argmax(axis=0)
    return np.stack([squares(records, size) for size in sizes])[level, np.arange(len(level))]


# What each variant queues, of each record. `persistent` hides by depth what an entry covers, `two_stage` draws some by rows.
ENTRIES: dict[str, Callable[[Records], NDArray[np.int64]]] = {
    "two_stage": lambda records: squares(records, 64),
    "persistent": lambda records: squares(records, 64),
    "recursive_descent": lambda records: squares(records, 64),
    "hierarchical_tiles": pyramid_entries,
    "tile_queues": lambda records: squares(records, 128) + squares(records, 8),
    "coverage_masks": lambda records: squares(records, 64) + squares(records, 8),
    "tile_owned": lambda records: squares(records, 16),
}


class Counted(NamedTuple):
    """What kernels count, and what there is to count."""

    of: dict[str, int]
    fragments: NDArray[np.int64]
    blocks: NDArray[np.int64]
    model: WorkMap
    records: Records
    set_up: Records  # with those that cover nothing
    job: Job

    def assert_bounds(self, most: int = 1) -> None:
        """What depends on no order, and of the rest what each order has: a pixel that is seen was offered its depth, and no
        pixel by any record more than ``most`` times."""
        seen = np.zeros(self.fragments.shape, bool)
        height, width = self.job.case.resolution
        seen[:height, :width] = self.job.packed != np.iinfo(np.int64).max
        assert (self.fragments >= seen).all() and (self.fragments <= most * self.model.fragments).all()
        assert self.fragments.sum() == self.blocks.sum() == self.of["fragments"]
        assert self.of["records"] == self.of["by_rows"] + self.of["by_tiles"]
        assert len(self.records.xy) <= self.of["records"] <= len(self.set_up.xy)
        assert self.of["passed"] <= self.of["fragments"]


@functools.cache
def counting_kernels() -> ctypes.CDLL:
    return cuda_on_cpu.build_counting(Path(tempfile.mkdtemp(dir=cuda_on_cpu.workspace().name)) / "counting")


def counted(name: str | Case, variant: str, settings: dict[str, int], room: int = 4096) -> Counted:
    case = case_of(name) if isinstance(name, str) else name
    every, _ = reference.setup(case.positions, case.triangles, *case.resolution)
    model = map_work(*case, variant="scanline", backend="reference")
    found, fragments = np.zeros(len(native.COUNTERS), np.int64), np.zeros(model.fragments.shape, np.int64)
    blocks, drawn = np.zeros(room, np.int64), job(case, variant, settings)
    to = cuda_on_cpu.counted_work(found, fragments, blocks)
    packed, _, _ = cuda_on_cpu.draw(counting_kernels(), drawn, to)
    assert np.array_equal(packed, drawn.packed), "what counts draws the same bits"
    of = dict(zip(native.COUNTERS, found.tolist(), strict=True))
    return Counted(of, fragments, blocks, model, without_empty(every, EXACT), every, drawn)


@exhaustive
def test_counters() -> None:
    """Records, what is queued of them, and the pixels that they cover, each offered its depth once: those of the reference's
    map. The sum over blocks is that of the pixels."""
    by_rows = {"scanline", "batched"}
    assert {*VARIANTS} == {"bin_owned", *by_rows, *ENTRIES}
    every = itertools.product((*by_rows, *ENTRIES), (*ODD, "many_small"))
    for (variant, name), search in zip(every, itertools.cycle((0, 256)), strict=False):
        settings = {"early_z": 0, "search": search, "rows": 0}
        of, fragments, blocks, model, records, _, _ = found = counted(name, variant, settings)
        found.assert_bounds()
        assert of["by_rows" if variant in by_rows else "by_tiles"] == of["records"] == len(records.xy), (variant, name)
        if variant in ENTRIES:
            assert of["entries"] == ENTRIES[variant](records).sum(), (variant, name)
        assert of["overflows"] == 0
        if variant == "persistent":
            counted_work.check_persistent(of, case_of(name), record_bytes(EXACT))
            assert (of["written"], of["atomics"]) == (found.job.packed.size, of["entries"]), name
        else:
            assert np.array_equal(fragments, model.fragments), (variant, name)
        if variant in counted_work.SAME:
            counted_work.check(variant, of, case_of(name), record_bytes(EXACT))
        # Of more blocks than there is room for, those that have room.
        _, again, few, *_ = counted(name, variant, settings, room=2)
        assert few.tolist() == blocks[:2].tolist() and np.array_equal(again, fragments), (variant, name)


@exhaustive
def test_counters_of_other_ways() -> None:
    """Fragments pass as in the reference where each triangle is drawn after the one before it; squares that are not separated."""
    # In one warp a queue is in the order of the triangles, and so is a pyramid of one level; a block that draws one triangle
    # alone has that order with more warps.
    alone = {"early_z": 0, "rows": 0, "blocks": 1, "search": 32, "batch": 1, "levels": 1, "share": 1024}
    in_order = [(variant, name, alone) for variant in ("scanline", "batched") for name in ("hundreds_in_a_bin", "many_small")]
    in_order += [(variant, "slivers_across", {**alone, "search": 256}) for variant in counted_work.SAME if variant != "batched"]
    for variant, name, settings in in_order:
        passed = counted(name, variant, settings).of["passed"]
        assert passed == counted_work.passed_in_order(case_of(name)), (variant, name)
    for name in ("long_slivers", "mixed"):
        found = counted(name, "recursive_descent", {"early_z": 0, "blocks": 1, "separate": 0}).of
        wanted = counted_work.recursive_descent(case_of(name), counted_work.records_of(case_of(name)), separate=False)
        assert {**wanted, "bytes": found["bytes"]} == {key: found[key] for key in wanted}, name


@exhaustive
def test_counters_of_what_depth_spares() -> None:
    """Tests of squares are the same with ``early_z``; a tile that is hidden spares its pixels' edge values and fragments, and no
    more than these."""
    hidden = {"recursive_descent": 0, "hierarchical_tiles": 0, "tile_owned": 0}
    spared = ("edges_32", "fragments", "passed", "written", "atomics", "tiles_hidden")
    for variant, name in itertools.product(hidden, ("hundreds_in_a_bin", "crowded", "mixed")):
        all_of, found = (counted(name, variant, {"early_z": early_z}) for early_z in (0, 1))
        found.assert_bounds()
        assert (found.fragments <= all_of.fragments).all(), (variant, name)
        assert {**found.of, **{key: all_of.of[key] for key in spared}} == all_of.of, (variant, name)
        tiles = found.of["tiles_hidden"]
        hidden[variant] += tiles
        assert all_of.of["tiles_hidden"] == 0
        if variant == "recursive_descent":
            assert found.of["passed"] == found.of["written"] <= found.of["atomics"] <= found.of["fragments"]
            assert (found.of["edges_32"], tiles) == (all_of.of["edges_32"], 0)
            continue
        assert (found.of["written"], found.of["atomics"]) == (all_of.of["written"], all_of.of["atomics"])
        edges, fragments = (all_of.of[key] - found.of[key] for key in ("edges_32", "fragments"))
        # 16x16 px: of those that are full no edge value is asked, and all pixels in the image are covered.
        assert 0 <= edges <= 3 * 256 * tiles and edges % (3 * 256) == 0, (variant, name)
        assert 0 <= fragments <= 256 * tiles, (variant, name)
    assert hidden["recursive_descent"] == 0 < min(hidden["hierarchical_tiles"], hidden["tile_owned"])


@exhaustive
def test_counters_of_bin_owned() -> None:
    """Where triangles are few, patches take all; else rows do, and patches and slivers what is too wide for them."""
    for name, (few, queue) in itertools.product((*ODD, "many_small"), ((65536, 65536), (0, 65536), (0, 1))):
        settings = {"few": few, "queue": queue}
        found, case = counted(name, "bin_owned", settings), case_of(name)
        of, by_patches = found.of, few and len(case.triangles) <= 256
        # A record that finds a bin's list full is looked at for all bins, also those that list it.
        found.assert_bounds(most=2 if of["overflows"] and not by_patches else 1)
        if by_patches:
            assert of["by_rows"] == 0 and (of["rows"] or not of["atomics"])  # small ones are drawn by rows onto patches
            seen = len(np.unique(bigtri.rasterize(*case).triangle)) - 1
            assert seen <= of["entries"] <= 8 * squares(found.records, 64).sum()
            assert of["written"] >= found.job.packed.size
        else:
            assert of["written"] == of["passed"]
        if not of["by_tiles"]:
            assert of["entries"] == of["overflows"] == 0
            assert np.array_equal(found.fragments, found.model.fragments), name
        elif not by_patches and queue == 1 and of["by_tiles"] > 2:  # a sliver and another one find room
            assert of["overflows"] >= of["by_tiles"] - 2


@exhaustive
def test_counters_of_patches() -> None:
    """Blocks of few triangles: what they gather and test, wherever records find room."""
    exact = hidden = by_rows = 0
    for name, (warps, region, entries) in itertools.product(ODD, ((8, 4, 352), (16, 8, 352), (16, 8, 2), (16, 16, 352))):
        case = case_of(name)
        if len(case.triangles) > 16 * warps:
            continue
        found = counted(name, "bin_owned", {"few": EVERY, "warps": warps, "region": region, "entries": entries})
        counted_work.check_few(found.of, case, found.set_up, warps, region)
        assert entries > 2 or found.of["overflows"] > 0
        by_rows += found.of["rows"] > 0
        if region == 16 and not found.of["rows"] and (wanted := counted_work.few_in_squares(found.set_up)):
            assert wanted == {key: found.of[key] for key in wanted}, name
            exact, hidden = exact + 1, hidden + wanted["bins_hidden"] + wanted["tiles_hidden"]
    assert exact > 1 and hidden > 0 and by_rows > 1


@exhaustive
def test_counters_of_rows() -> None:
    """Rows, boxes and slivers, and what waits beside them, in bins or patches."""
    # Blocks that draw their triangles together, up to wide ones, also in teams; warps that draw by boxes where most are small, or
    # leave rows to others; slivers in two bands.
    together, wide = {"share": 32, "widest": 64}, {"share": 32, "widest": 256}
    ways = (
        together,
        {**wide, "team": 4},
        wide,
        {"share": 128, "widest": 64},
        {"share": 256, "widest": 256},
        {**together, "cache": 800_000},
    )
    for way, name, variant in itertools.product(ways, (*ODD, "many_small"), ("two_stage", "bin_owned")):
        found = counted(name, variant, {"few": 0, **way})
        found.assert_bounds()
        how = way["widest"], way["share"] == 32, record_bytes(EXACT)
        counted_work.check_rows(variant, found.of, case_of(name), found.set_up, *how)


LARGE, MIDDLE = 130, 68  # px, sides of boxes of which a triangle covers 7,394 px, which count, and 2,023, which do not
SHAPE = [[0, 0], [1, 0.25], [0.5, 1]]


def in_blocks(resolution: tuple[int, int], each: int, blocks: tuple[tuple[int, ...], ...]) -> Case:
    """Triangles that are set up together, `each` a block: sides of some of them, px; the rest are tiny. Two more blocks have thin
    ones that are longer, and ones of which the screen leaves a corner."""
    count = max(-(-280 // each), len(blocks) + 2)
    height, width = resolution
    side = np.full((each, count), 2.0)
    for block, sides in enumerate(blocks):
        side[: len(sides), block] = sides
    shape = np.broadcast_to(SHAPE, (each, count, 3, 2)).copy()
    thin, cut, beyond = len(blocks), len(blocks) + 1, 450
    side[:4, thin], side[:4, cut] = 190, beyond
    shape[:, thin] = [[0, 0], [1, 1], [0.98, 1]]
    rng = np.random.default_rng(len(blocks))
    corner = rng.uniform(0, 1, (each, count, 2)) * (np.array([width, height]) - np.where(side < beyond, side, 0)[..., None] - 1)
    corner[:4, cut] = [width - 20, height - 15]
    xy = corner[:, :, None] + side[..., None, None] * shape
    return from_pixels(xy.reshape(-1, 3, 2), rng.uniform(0.1, 0.9, (each * count, 3)), resolution)


def counted_views(case: Case, views: int, settings: dict[str, int]) -> tuple[dict[str, int], NDArray[np.int64]]:
    """What `bin_owned` counts of so many equal views, and pixels that blocks draw."""
    one = job(case, "bin_owned", {"few": 0, **settings})
    packed, depth, dropped = (np.stack([of_one] * views) for of_one in (one.packed, one.depth, one.dropped))
    seen = case._replace(positions=np.stack([case.positions] * views))
    height, width = (-(-pixels // 64) * 64 for pixels in case.resolution)
    found, fragments, blocks = (np.zeros(n, np.int64) for n in (len(native.COUNTERS), views * height * width, 4096))
    to = cuda_on_cpu.counted_work(found, fragments, blocks)
    drawn, _, _ = cuda_on_cpu.draw(counting_kernels(), Job(seen, packed, depth, dropped, one.variant, one.settings), to)
    assert np.array_equal(drawn, packed)
    return dict(zip(native.COUNTERS, found.tolist(), strict=True)), blocks


def waiting(case: Case, each: int, views: int = 1, **settings: int) -> int:
    """How many triangles wait for blocks that own pixels, of those of equal views that are drawn `each` a block."""
    return counted_views(case, views, {"share": each, **settings})[0]["by_tiles"]


@pytest.mark.parametrize(
    ("resolution", "each", "blocks", "wait"),
    [
        # Up to 15,200 px on average: 14,788; 22,182; 18,434 with 3,544 of 90 px; 15,674, but these alone have less than half;
        # no more with those that do not count; 15,497; 14,737.
        ((400, 400), 4, ((LARGE,) * 2, (LARGE,) * 4, (LARGE, 90), (LARGE,), (MIDDLE,) * 4, (LARGE,) * 2, (LARGE, 90)), 8),
        ((400, 400), 32, ((LARGE,) * 16, (LARGE,) * 17), 17),  # 121,600; 118,304, 122,001
        ((400, 400), 256, ((LARGE,) * 16, (LARGE,) * 17), 17),  # the same of a warp
        ((1000, 1000), 4, ((LARGE, MIDDLE), (LARGE, 90)), 2),  # 8,480; 7,394, 9,166
    ],
)
def test_large_triangles_wait_where_blocks_have_many(
    resolution: tuple[int, int], each: int, blocks: tuple[tuple[int, ...], ...], wait: int
) -> None:
    """Blocks are drawn in this order here, so that each knows of those before it."""
    case = in_blocks(resolution, each, blocks)
    assert waiting(case, each) == wait
    assert waiting(case, each, widest=256) == 0, "the caller's limit is the only one"
    assert counted(case, "two_stage", {"share": each}).of["by_tiles"] == 0


@pytest.mark.parametrize(
    ("sides", "wait"),
    [
        ((LARGE,) * 16, 16),  # of each block four, 29,576 px of up to 13,200 on average
        ((LARGE,) * 3, 0),  # 22,182 px of up to 26,400 that are drawn without asking
        ((LARGE, 115, 2, 2) * 4, 0),  # 13,180
        ((LARGE, 116, 2, 2) * 4, 8),  # 13,281
        # What the first block finds holds, though those after it find another mean: 7,394, then 18,485 and 14,787 px; 29,576,
        # 16,560 and then 12,221.
        ((LARGE, 2, 2, 2, *(LARGE,) * 4, LARGE), 0),
        ((*(LARGE,) * 4, 2, 2, 2, 2, 90, 2, 2, 2, 90, 2, 2, 2), 6),
    ],
)
def test_blocks_of_a_team_agree_whether_large_triangles_wait(sides: tuple[int, ...], wait: int) -> None:
    assert waiting(in_blocks((400, 400), 16, (sides,)), 16, team=4) == wait


def test_few_large_triangles_do_not_wait_in_a_large_image() -> None:
    """288 triangles of 1,736 px each cover half of the image, so that a block's four wait only above 6,944 px."""
    case = in_blocks((1000, 1000), 16, ((124, 2, 2, 2) * 4,))  # 6,727 px; else they would wait from 6,480 on
    assert len(case.triangles) == 288
    assert waiting(case, 16, team=4) == 0
    assert waiting(in_blocks((1000, 1000), 16, ((127, 2, 2, 2) * 4,)), 16, team=4) == 4  # 7,056


def test_few_triangles_are_drawn_by_a_team() -> None:
    """Of as many as this small a device can hold teams for. A block takes every fourth 32 of their rows."""
    corners = np.arange(8)[:, None, None] * 20 + 5 + 90 * np.array(SHAPE)
    case = from_pixels(corners, np.full((8, 3), 0.5), (300, 400))
    for settings, blocks in (({}, 4), ({"team": 1}, 2), ({"team": 2}, 2), ({"share": 8}, 1), ({"share": 4, "team": 2}, 4)):
        found = counted(case, "bin_owned", {"few": 0, **settings})
        assert np.count_nonzero(found.blocks) == blocks, settings


@pytest.mark.parametrize(
    ("resolution", "count", "region"),
    [
        ((300, 400), 128, 4),
        ((512, 512), 128, 8),
        ((512, 512), 129, 8),
        ((480, 640), 128, 8),
        ((480, 640), 129, 4),
        ((512, 641), 129, 8),
        ((1024, 1024), 129, 8),
        ((1025, 1024), 128, 16),
    ],
)
def test_regions_are_low_in_small_images(resolution: tuple[int, int], count: int, region: int) -> None:
    corners = np.full((count, 3, 2), 5) + 60 * np.array(SHAPE)
    case = from_pixels(corners, np.linspace(0.1, 0.9, 3 * count).reshape(count, 3), resolution)
    of = {of: counted(case, "bin_owned", {"region": of}).of for of in (4, 8, 16)}
    assert of[4] != of[8] != of[16]
    assert counted(case, "bin_owned", {}).of == of[region]


def test_a_team_shares_out_few_rows_evenly() -> None:
    """Up to 512 rows: of 32 warps each takes 16 at a time, of 64 eight; the first ones are those of different blocks."""
    for side, team, blocks in ((63, 4, 4), (63, 2, 2), (63, 8, 8), (33, 4, 3), (31, 4, 2), (15, 4, 1), (31, 2, 1), (15, 8, 2)):
        case = from_pixels(5 + side * np.array([SHAPE]), np.full((1, 3), 0.5), (100, 100))
        found = counted(case, "bin_owned", {"few": 0, "share": 4, "team": team})
        assert np.count_nonzero(found.blocks) == blocks, (side, team)
        assert found.of["rows"] == counted(case, "bin_owned", {"few": 0, "team": 1}).of["rows"], "none is drawn twice"
    # Of more each takes 32: a block every fourth triangle here, of which only these are wide.
    for count, alone in ((17, True), (16, False)):
        size = np.where(np.arange(count) % 4 == 0, 40, 2)[:, None, None] * [1, 0] + [0, 32]
        case = from_pixels(5 + size * np.array(SHAPE), np.full((count, 3), 0.5), (100, 100))
        blocks = counted(case, "bin_owned", {"few": 0, "share": 32, "team": 4}).blocks
        assert (blocks.max() > 0.8 * blocks.sum()) == alone, blocks[:4]


@pytest.mark.parametrize(
    ("resolution", "views", "count", "settings", "widest"),
    [
        ((700, 800), 1, 280, {}, 192),
        ((700, 800), 1, 280, {"team": 4}, 256),  # the blocks of a team share the rows
        ((700, 800), 1, 280, {"team": 2}, 192),
        ((700, 800), 1, 256, {}, 192),
        ((700, 700), 1, 256, {}, 96),  # a few triangles, of which most blocks have none
        ((700, 700), 1, 257, {}, 256),  # few pixels
        ((800, 800), 1, 27, {}, 192),
        ((800, 800), 1, 27, {"team": 4}, 256),
        ((800, 800), 1, 26, {"team": 4}, 64),  # more than 24,576 px for each
        ((800, 800), 2, 63, {}, 192),
        ((800, 800), 2, 62, {}, 64),  # more than 10,240
        ((800, 800), 2, 256, {}, 192),
        ((800, 800), 2, 257, {}, 256),  # as many as keep blocks busy
        ((2048, 2047), 1, 260, {}, 192),
        ((2048, 2048), 1, 260, {}, 256),  # many pixels
    ],
)
def test_how_wide_triangles_are_that_rows_draw(
    resolution: tuple[int, int], views: int, count: int, settings: dict[str, int], widest: int
) -> None:
    """Two flat triangles, one of which is a pixel wider than that."""
    corners = np.full((count, 3, 2), 5) + SHAPE
    corners[:2] = 5 + np.array([[widest], [widest + 1]])[:, None] * [[0, 0], [1, 0], [0.5, 0.08]]
    case = from_pixels(corners, np.full((count, 3), 0.5), resolution)
    assert waiting(case, 4, views, **settings) == views


def test_more_triangles_are_drawn_by_two_blocks_in_a_large_image() -> None:
    """As many as make one turn. All triangles but one lie outside of the image: who draws has a part of its rows."""
    for count, resolution, blocks in (
        (32, (1024, 1025), 2),
        (33, (1024, 1025), 1),
        (32, (1024, 1024), 1),
        (9, (1024, 1025), 2),
        (8, (1024, 1025), 4),
    ):
        corners = np.full((count, 1, 1), -100) + 5 + 90 * np.array(SHAPE)
        corners[0] += 200
        case = from_pixels(corners, np.full((count, 3), 0.5), resolution)
        found = counted(case, "bin_owned", {"few": 0, "widest": 128})
        assert np.count_nonzero(found.blocks) == blocks, (count, resolution)


def test_shares_make_one_turn_or_two() -> None:
    """Of this small device's two blocks each gets half, as long as that is up to 256; of views that have many pixels for each
    triangle up to 124, twice; of such that have more, in more turns."""
    corners = np.arange(513)[:, None, None] % 8 * 5 + 5 + 10 * np.array(SHAPE)
    each = int(counted_views(from_pixels(corners[:1], np.full((1, 3), 0.5), (50, 50)), 1, {})[1].sum())
    for resolution, views, count, shares in (
        ((50, 50), 1, 248, [124, 124]),
        ((50, 50), 1, 249, [125, 124]),
        ((50, 50), 1, 512, [256, 256]),
        ((50, 50), 1, 513, [172, 171, 170]),
        ((200, 200), 1, 300, [150, 150]),
        ((100, 100), 2, 150, [75, 75] * 2),
        ((100, 100), 2, 248, [124, 124] * 2),
        ((200, 200), 2, 150, [30] * 5 * 2),  # 267 px for each, of 8,192 a block
        ((200, 200), 2, 75, [19, 19, 19, 18] * 2),  # 533 px for each: 24 a block at least
        ((60, 59), 2, 150, [150] * 2),  # less than 24 px for each
        ((60, 60), 2, 150, [75, 75] * 2),
        ((174, 174), 2, 300, [60] * 5 * 2),  # 101 px for each: in more than two turns together
        ((173, 173), 2, 300, [100] * 3 * 2),
        ((173, 173), 2, 250, [63, 63, 62, 62] * 2),
        ((80, 80), 2, 250, [250] * 2),  # to the end of one turn
        ((60, 60), 2, 250, [126, 124] * 2),  # in fours
    ):
        given = from_pixels(corners[:count], np.full((count, 3), 0.5), resolution)
        _, blocks = counted_views(given, views, {})
        assert (blocks[blocks > 0] // each).tolist() == shares, (resolution, views, count)


def test_triangles_that_make_one_turn_are_shared_out_to_the_whole_device() -> None:
    """If each block got six of 41, the last of eight would get none."""
    corners = np.arange(41)[:, None, None] % 8 * 5 + 5 + 10 * np.array(SHAPE)
    case = from_pixels(corners, np.full((41, 3), 0.5), (50, 50))
    each = int(counted_views(from_pixels(corners[:1], np.full((1, 3), 0.5), (50, 50)), 1, {})[1].sum())
    counting_kernels().use_device(1)
    try:
        for count, shares in ((41, [6] + [5] * 7), (30, [4] * 6 + [3] * 2), (28, [4] * 7)):
            some = case._replace(triangles=case.triangles[:count])
            _, blocks = counted_views(some, 1, {"team": 1})
            assert (blocks[blocks > 0] // each).tolist() == shares, count
            _, blocks = counted_views(some, 1, {"share": 8})
            assert np.count_nonzero(blocks) == -(-count // 8), "as the caller wants it"
        # Teams of four blocks get two triangles at least.
        large = from_pixels(np.arange(4)[:, None, None] * 20 + 5 + 90 * np.array(SHAPE), np.full((4, 3), 0.5), (725, 725))
        assert np.count_nonzero(counted_views(large, 1, {"widest": 128})[1]) == 8
    finally:
        counting_kernels().use_device(0)


def test_what_touches_many_bins_is_looked_at_for_all_unless_views_are_many() -> None:
    """Six records of each view, of 65 bins. The first 64 blocks look at for all bins anyway, and of those in lists the first of a
    view finds room: 26 of 96 are neither."""
    corners = np.tile([[0, 0], [65 * 64, 0], [0, 500]], (6, 1, 1))
    case = from_pixels(corners, np.linspace(0.1, 0.8, 18).reshape(6, 3), (64, 65 * 64))
    for views, full in ((15, 0), (16, 26 * 65)):
        overflows = counted_views(case, views, {"queue": 96 * 2})[0]["overflows"]
        assert overflows == full, views


def test_large_triangles_of_views_and_parts_of_clipped_ones_wait() -> None:
    case = in_blocks((400, 400), 4, ((LARGE,) * 2,))  # 14,788 px of up to 15,200
    assert waiting(case, 4) == 0
    assert waiting(case, 4, views=2) == 2 * 2, "up to 8,000 px"
    assert waiting(in_blocks((400, 400), 4, ((LARGE, 45),)), 4, views=2) == 0  # 7,394, for 45 px are not large
    assert waiting(in_blocks((400, 400), 4, ((LARGE, 90),)), 4, views=2) == 2 * 2  # 10,938
    assert waiting(in_blocks((750, 750), 4, ((LARGE,),)), 4, views=2) == 0, "up to 8,338 px, as the image has 2,009 for each"
    corners = np.full((300, 3, 2), 5) + SHAPE
    corners[7] = 5 + 250 * np.array(SHAPE)
    depth = np.full((300, 3), 0.5)
    depth[7, 0] = -0.2  # the near plane leaves a quadrangle, two triangles
    assert waiting(from_pixels(corners, depth, (400, 400)), 4) == 2


@exhaustive
def test_counters_of_full_queues() -> None:
    """What finds no room is counted where it is drawn: where nothing is hidden, all fragments are those of the reference."""
    for name in ODD:
        records = 0
        for variant in ENTRIES:
            found = counted(name, variant, {"queue": 1, "rows": 0, "early_z": 0})
            found.assert_bounds(most=2)
            records = found.of["records"]
            assert found.of["overflows"] >= (records > 1), (variant, name)
            if variant in ("two_stage", "recursive_descent"):
                assert found.of["overflows"] >= records - 1, (variant, name)
                assert np.array_equal(found.fragments, found.model.fragments), (variant, name)
            if variant == "two_stage":  # bins are tested once less, but what is drawn of them is the same
                wanted = counted_work.two_stage(found.job.case, found.records)
                assert all(found.of[key] == n for key, n in wanted.items() if key.startswith("tiles") or key == "edges_32"), name
        found = counted(name, "persistent", {"patch": 0})  # its pixels lie in the image
        found.assert_bounds()
        of = found.of
        assert (
            int((found.job.packed != np.iinfo(np.int64).max).sum())
            <= of["passed"]
            == of["written"]
            <= of["atomics"] - of["entries"]
            <= of["fragments"]
        ), name
        found = counted(name, "two_stage", {"rows": 1})
        found.assert_bounds()
        assert records <= found.of["records"]
        assert np.array_equal(found.fragments, found.model.fragments), name


@pytest.mark.skipif(not BENCH.exists(), reason="bench/ is not here")
def test_fragments_of_the_bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The kernels of bench/fragments.cu: all ways end in the same picture, and the bits are those of ``scanline``."""
    monkeypatch.syspath_prepend(str(BENCH))
    fragments, cases_of = map(importlib.import_module, ("fragments", "variant_cases"))
    monkeypatch.setattr(cases_of, "AT_LEAST", 1)
    folder = tmp_path / "build"
    cuda_on_cpu.copy_sources(folder)
    there = [cuda_on_cpu.unchanged("exact") / f"{name}.o" for name in (*cuda_on_cpu.SOURCES, "cuda_on_cpu")]
    built = cuda_on_cpu.compile_and_link(folder, [BENCH / "fragments.cu"], there, "exact", "-Og", f"-I{folder}")
    built.fragments_srgb.restype = ctypes.c_int64
    for name, size in (("R4k", (96, 64)), ("S2", (320, 240)), ("S4b", (96, 64))):
        rows = fragments.Scene(built, "cpu", name, *size).rows(0, fragments.whence("cpu"))
        assert [(row.way, row.differing_px) for row in rows] == [(way, 0) for way in fragments.WAYS]
        assert rows[0].covered_px > 100
