"""The CUDA kernels against the CPU, in bits: every variant, every case, every way through the kernels, all launch settings."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
import pytest
import test_capacity
import torch
from cases import CASES, Case, random_corners, soup
from cuda_bits import (
    DEVICE,
    PATHS,
    VARIANTS,
    Scene,
    as_bits,
    assert_same,
    case_of,
    cpu_picture,
    draw,
    expected,
    moved,
    needs_cuda,
    paths_of,
    poison,
    that_differ,
    uploaded,
    values_of,
)

import bigtri
from bigtri import native
from bigtri.ops.rasterize import CULLS, Visibility
from bigtri.precision import DEFAULT, RUNGS
from bigtri.study.accuracy import reversed_depth

pytestmark = needs_cuda


@pytest.fixture(autouse=True)
def _leave_no_memory() -> Iterator[None]:
    """Several processes may share the device (pytest -n)."""
    yield
    torch.cuda.empty_cache()


BACKGROUND = 2**63 - 1
SIZES = ((540, 960), (567, 1000), (1080, 1920))
SEEDED = [name for name in CASES if not name.startswith("size")]
LARGE = ("size_1919x1079", "size_16384x7", "size_3x16384")  # the reference takes its time for these


each_variant = pytest.mark.parametrize("variant", VARIANTS)
each_way = pytest.mark.parametrize(("variant", "path"), [(v, p) for v in VARIANTS for p in paths_of(v)], indirect=["path"])


@pytest.fixture
def path(request):
    with native.using_parameters(**PATHS[request.param]):
        yield


# --- Bits ------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", CASES)
@each_way
def test_every_case(name, variant, path):
    for seed, cull in itertools.product(range(6 if name in SEEDED else 1), CULLS):
        scene = Scene(name, seed)
        assert_same(expected(scene, cull), draw(scene, variant=variant, cull=cull), (scene, cull))


@pytest.mark.parametrize("name", [name for name in CASES if name not in LARGE])
@each_way
def test_the_reference_itself(name, variant, path):
    assert_same(expected(Scene(name), backend="reference"), draw(Scene(name), variant=variant), name)


@pytest.mark.parametrize("size", SIZES, ids=lambda size: f"{size[1]}x{size[0]}")
@pytest.mark.parametrize("name", ["S1", "S2", "S3", "S4f", "S4b", "S6-200k"])
@each_variant
def test_benchmark_scenes(name, size, variant):
    scene = Scene(name, size=size)
    for path in [p for p in paths_of(variant) if p in ("default", "tested") or not name.startswith("S6")]:
        with native.using_parameters(**PATHS[path]):
            assert_same(expected(scene), draw(scene, variant=variant), (scene, path))


@pytest.mark.parametrize(
    ("name", "size", "seed"),
    [
        ("S5", (1080, 1920), 0),
        ("S5", (1080, 1920), 7),
        ("S6", (1080, 1920), 0),
        ("S6", (256, 256), 0),
        ("S8", (256, 256), 0),  # in teams, by rows; at 1080p their large ones wait
        ("S8", (1080, 1920), 0),
        ("S7", (567, 1000), 0),
        ("S7", (1080, 1920), 3),
    ],
)
@each_variant
def test_scenes_of_many_triangles(name, size, seed, variant):
    scene = Scene(name, seed, size)
    for path in [p for p in paths_of(variant) if p in ("default", "apart", "tested") or name == "S5"]:
        for cull in ("none", "back") if size == (256, 256) else ("none",):
            with native.using_parameters(**PATHS[path]):
                assert_same(expected(scene, cull), draw(scene, variant=variant, cull=cull), (scene, path, cull))


@pytest.mark.parametrize("blocks", [34, 35, 36])
@pytest.mark.parametrize("variant", ["bin_owned", "two_stage"])
def test_triangles_in_turns_of_so_many_blocks(variant, blocks):
    """Blocks begin far from each other in the list, so far that each has its own share."""
    corners = random_corners(np.random.default_rng(blocks), 128 * blocks, 0.9)
    corners[::5, 1, 2] = np.nan  # dropped, and counted once
    case = soup(corners, (70, 90))
    arguments = [torch.from_numpy(a).to(DEVICE) for a in (case.positions, case.triangles)]
    with native.using_parameters(**PATHS["tested"]):
        assert_same(cpu_picture(case, "native"), bigtri.rasterize(*arguments, case.resolution, variant=variant), blocks)


SCISSORS = {
    "bins": (64, 64, 128, 128),
    "odd": (33, 17, 130, 90),
    "pixel": (50, 50, 51, 51),
    "empty": (70, 20, 70, 90),
    "outside": (5000, 5000, 6000, 6000),
    "before": (-50, -50, -10, -10),
    "across": (-10, -10, 40, 33),
    "beyond": (40, 33, 2**40, 2**40),
}


@pytest.mark.parametrize("box", SCISSORS)
@pytest.mark.parametrize(
    "name", ["screen_size", "many_small", "corner_of_huge", "slivers", "layers", "mixed", "long_slivers", "small_by_the_screen"]
)
@each_way
def test_scissor(name, box, variant, path):
    scissor = SCISSORS[box]
    assert_same(expected(Scene(name), scissor=scissor), draw(Scene(name), variant=variant, scissor=scissor), (name, box))


@pytest.mark.parametrize("name", ["size_16384x64", "size_64x16384", "size_128x67", "size_67x130"])
@each_way
def test_shapes_of_images(name, variant, path):
    for seed in range(3):
        assert_same(expected(Scene(name, seed)), draw(Scene(name, seed), variant=variant), (name, seed))


@each_variant
def test_the_largest_image(variant):
    """2 GiB: offsets of pixels pass 2^31 bytes."""
    case = case_of(Scene("screen_size"))._replace(resolution=(16384, 16384))
    wanted = cpu_picture(case, depth=False)
    positions, triangles, _ = uploaded(Scene("screen_size"))
    for path in paths_of(variant):
        with native.using_parameters(**PATHS[path]):
            got = bigtri.rasterize(positions, triangles, case.resolution, variant=variant, depth=False)
        assert torch.equal(wanted.packed, got.packed) and wanted.dropped == got.dropped, path
        del got


@pytest.mark.parametrize(
    "make", [test_capacity.a_million_small_in_one_bin, test_capacity.a_million_large_in_one_bin], ids=lambda make: make.__name__
)
@each_variant
def test_a_million_in_one_bin(make, variant):
    made = make()
    case = made if isinstance(made, Case) else made[0]
    wanted = cpu_picture(case)
    arguments = [torch.from_numpy(a).to(DEVICE) for a in case[:2]]
    assert_same(wanted, bigtri.rasterize(*arguments, case.resolution, variant=variant))


@each_variant
def test_more_than_float32_can_count(variant):
    """2^24 + 3 triangles, of which the last two are seen."""
    positions = torch.tensor([[-1, -1, 0, 1], [3, -1, 0, 1], [-1, 3, 0, 1], [5, 5, 0, 1]], dtype=torch.float32, device=DEVICE)
    triangles = torch.full((2**24 + 3, 3), 3, dtype=torch.int32, device=DEVICE)
    triangles[-2:] = torch.arange(3, dtype=torch.int32, device=DEVICE)
    assert (bigtri.rasterize(positions, triangles, (9, 9), variant=variant, depth=False).triangle == 2**24 + 1).all()


# --- Arguments of every kind -------------------------------------------------------------------------------------------------


def misaligned(values: torch.Tensor, offset: int = 1) -> torch.Tensor:
    """The same numbers, contiguous, ``offset`` elements after what the allocator aligned."""
    memory = torch.empty(values.numel() + offset, dtype=values.dtype, device=values.device)
    return memory[offset:].view(values.shape).copy_(values)


@pytest.mark.parametrize("name", ["screen_size", "mixed", "size_63x63", "size_64x64", "size_128x67"])
@each_way
def test_memory_of_any_alignment(name, variant, path):
    """positions at 4, 8 and 12 bytes from where a vertex could be read at once, packed at 8 from where two pixels could be."""
    positions, triangles, resolution = uploaded(Scene(name))
    wanted = expected(Scene(name))
    for offset in (1, 2, 3):
        out = misaligned(torch.full(resolution, 77, device=DEVICE), offset)
        got = bigtri.rasterize(misaligned(positions, offset), misaligned(triangles, offset), resolution, variant=variant, out=out)
        assert got.packed.data_ptr() == out.data_ptr() and out.data_ptr() % 16 == offset % 2 * 8
        assert_same(wanted, got, offset)


@pytest.mark.parametrize("name", ["screen_size", "many_small", "mixed"])
@each_variant
def test_memory_of_any_layout(name, variant):
    positions, triangles, resolution = uploaded(Scene(name))
    strided = positions.repeat_interleave(2, dim=0)[::2]
    column_major = triangles.t().contiguous().t()
    assert not strided.is_contiguous() and not column_major.is_contiguous()
    for arguments in ((strided, triangles), (positions, column_major), (strided, column_major)):
        assert_same(expected(Scene(name)), bigtri.rasterize(*arguments, resolution, variant=variant))


@pytest.mark.parametrize("name", ["screen_size", "mixed"])
@each_way
def test_depth_can_be_left_out(name, variant, path):
    assert_same(expected(Scene(name))._replace(depth=None), draw(Scene(name), variant=variant, depth=False))


@pytest.mark.parametrize("name", ["size_63x63", "size_128x67", "size_1x65", "mixed"])
@each_way
def test_nothing_is_written_outside_the_image(name, variant, path):
    positions, triangles, (height, width) = uploaded(Scene(name))
    memory = torch.full((3, height, width), 0x5555, device=DEVICE)
    got = bigtri.rasterize(positions, triangles, (height, width), variant=variant, out=memory[1])
    assert_same(expected(Scene(name)), got)
    assert (memory[0] == 0x5555).all() and (memory[2] == 0x5555).all()


@pytest.mark.parametrize("resolution", [(61, 75), (64, 64), (128, 130)])
@each_way
def test_batch(resolution, variant, path):
    """Views of all kinds, an odd number of pixels each; one outside, one not finite."""
    names = ["screen_size", "behind_camera", "slivers", "far_depth", "on_planes", "many_small", "not_finite"]
    views = np.stack([case_of(Scene(name)).positions[:90] for name in names])
    views[-2] += 100
    triangles = np.arange(90, dtype=np.int32).reshape(-1, 3)
    for count in (1, 3, len(names)):
        wanted = cpu_picture(Case(views[-count:], triangles, resolution))
        arguments = torch.from_numpy(views[-count:]).to(DEVICE), torch.from_numpy(triangles).to(DEVICE)
        assert_same(wanted, bigtri.rasterize(*arguments, resolution, variant=variant), count)


@pytest.mark.parametrize("shape", [(0, 4), (5, 4), (0, 5, 4), (2, 0, 4), (3, 5, 4), (0, 0, 4)])
@each_way
def test_nothing_to_draw(shape, variant, path):
    positions, triangles = torch.ones(shape), torch.zeros((0, 3), dtype=torch.int32)
    poison(0, 8 * 30, 8 * 90)
    got = bigtri.rasterize(positions.to(DEVICE), triangles.to(DEVICE), (5, 6), variant=variant)
    assert_same(moved(bigtri.rasterize(positions, triangles, (5, 6)), DEVICE), got)
    assert (got.packed == BACKGROUND).all() and (got.dropped == 0).all()


@pytest.mark.parametrize("name", ["screen_size", "mixed"])
@pytest.mark.parametrize("index", [-1, "V", 2**31 - 1, -(2**31)])
@each_way
def test_an_index_out_of_range_is_dropped_and_counted(index, name, variant, path):
    """The picture is that of the others: such a triangle has become one without an area."""
    case = case_of(Scene(name))
    which = np.random.default_rng(1).permutation(len(case.triangles))[:11]
    without, wrong = case.triangles.copy(), case.triangles.copy()
    without[which] = 0
    wrong[which, np.arange(11) % 3] = len(case.positions) if index == "V" else index
    finite = np.isfinite(case.positions[case.triangles]).all(axis=(1, 2))
    wanted = cpu_picture(case._replace(triangles=without))
    wanted = wanted._replace(dropped=torch.tensor(int((~finite).sum() + finite[which].sum()), device=DEVICE))
    positions = uploaded(Scene(name))[0]
    triangles = torch.from_numpy(wrong).to(DEVICE)
    assert_same(wanted, bigtri.rasterize(positions, triangles, case.resolution, variant=variant))
    out = torch.full(case.resolution, 77, device=DEVICE)
    with pytest.raises(RuntimeError, match=f"triangles must index positions, 0 to {len(case.positions) - 1}, got indices from"):
        bigtri.rasterize(positions, triangles, case.resolution, variant=variant, validate=True, out=out)
    assert (out == 77).all()


@each_way
def test_triangles_without_vertices_are_all_dropped(variant, path):
    triangles = torch.zeros((1000, 3), dtype=torch.int32, device=DEVICE)
    for shape, dropped in (((0, 4), 1000), ((2, 0, 4), [1000, 1000])):
        got = bigtri.rasterize(torch.zeros(shape, device=DEVICE), triangles, (9, 70), variant=variant)
        assert (got.packed == BACKGROUND).all() and got.dropped.tolist() == dropped


# --- Launch settings ---------------------------------------------------------------------------------------------------------

# Each value by itself, then random combinations, others for every scene.
SETTINGS = {
    p.name: values_of(p) for v in native.REGISTRY.get("cuda", {}).get(DEFAULT, {}).values() for p in v.parameters.values()
}
COMBINATIONS = 100


def combinations(name: str) -> list[dict[str, int]]:
    alone = [{field: value} for field, values in SETTINGS.items() for value in values]
    alone += [{**path, field: value} for path in PATHS.values() for field, values in SETTINGS.items() for value in values]
    rng = np.random.default_rng(list(name.encode()))
    together = [{field: values[rng.integers(len(values))] for field, values in SETTINGS.items()} for _ in range(COMBINATIONS)]
    return [*alone, *together]


@pytest.mark.parametrize(
    "name",
    [
        *("behind_camera", "guard_band", "inside_sphere", "slivers", "needles_on_centres", "far_depth", "many_small"),
        *("layers", "full_screens", "crowded", "corner_of_huge", "ties_at_bounds", "size_128x67", "mixed"),
        *("clipped_fans", "hundreds_in_a_bin", "hundreds_in_a_list", "long_slivers", "small_on_cells"),
    ],
)
@each_variant
def test_launch_settings_change_no_bit(name, variant):
    wanted = expected(Scene(name))
    known = native.REGISTRY["cuda"][DEFAULT][variant].parameters
    for changes in that_differ(known, combinations(name)):
        with native.using_parameters(**changes):
            got = draw(Scene(name), variant=variant)
        assert_same(wanted, got, changes)


def test_settings_are_checked():
    for wrong in (
        {"warps": 5},
        {"entries": 0},
        {"entries": 353},
        {"queue": 0},
        {"blocks": -1},
        {"few": -1},
        {"widest": 257},
        {"share": -1},
        {"cache": -1},
        {"few": 2**17},
    ):
        (name,) = wrong
        with pytest.raises(ValueError, match=f"using_parameters: {name} must be "), native.using_parameters(**wrong):
            pass
        with pytest.raises(ValueError, match=f"parameter {name} of variant 'bin_owned' must be "):
            draw(Scene("mixed"), variant="bin_owned", parameters=wrong)


@pytest.mark.parametrize("precision", [name for name in native.REGISTRY.get("cuda", {}) if name != DEFAULT])
@pytest.mark.parametrize("name", CASES)
def test_every_rung_has_the_cpu_s_bits(name, precision):
    positions, triangles, resolution = uploaded(Scene(name))
    if RUNGS[precision].reversed:
        positions = torch.from_numpy(reversed_depth(positions.cpu().numpy())).to(DEVICE)
    wanted = bigtri.rasterize(positions.cpu(), triangles.cpu(), resolution, precision=precision)
    colors = torch.rand(len(positions), 3)
    for variant in native.REGISTRY["cuda"][precision]:
        for settings in ({}, {"queue": 3}, {"rows": 0, "share": 128}):
            with native.using_parameters(**settings):
                got = bigtri.rasterize(positions, triangles, resolution, precision=precision, variant=variant)
            assert_same(moved(wanted, DEVICE), got, (variant, settings))
    values = bigtri.interpolate(colors.to(DEVICE), got, positions, triangles, precision=precision).cpu()
    right = bigtri.interpolate(colors, wanted, positions.cpu(), triangles.cpu(), precision=precision)
    assert torch.equal(as_bits(values), as_bits(right))


# --- Again and again -----------------------------------------------------------------------------------------------------------

REPEATED = {
    **PATHS,
    "tiny queue": {"few": 0, "widest": 8, "queue": 3},
    "short lists": {"few": 0, "widest": 8, "queue": 600},
    "two bands": {"few": 0, "cache": 400_000},
    "tiny lists": {"few": 65536, "entries": 2},
    "all queued": {"few": 0, "widest": 1, "entries": 7},
    "little queued": {"few": 0, "widest": 256},
}


@pytest.mark.parametrize("settings", REPEATED)
@each_variant
def test_a_hundred_runs_give_the_same_bits(settings, variant):
    """Onto memory that holds what would win, what would lose and what is nothing, so that a pixel left out shows."""
    scene = Scene("mixed")
    height, width = case_of(scene).resolution
    wanted = expected(scene)
    out = torch.empty(height, width, dtype=torch.int64, device=DEVICE)
    with native.using_parameters(**REPEATED[settings]):
        for run in range(100):
            byte = (0x00, 0xFF, 0x7F, 0x55)[run % 4]
            poison(byte, 4 * height * width, 8 * height * width)
            out.view(torch.uint8).fill_(byte)
            assert_same(wanted, draw(scene, variant=variant, out=out if run % 2 else None), (settings, run))


@each_variant
def test_scenes_after_one_another(variant):
    """What one frame leaves in memory is nothing to the next."""
    order = np.random.default_rng(2).choice(
        ["mixed", "layers", "many_small", "size_1x1", "crowded", "slivers", "screen_size"], 150
    )
    for k, name in enumerate(order):
        path = list(PATHS.values())[k % len(PATHS)]
        with native.using_parameters(**path):
            assert_same(expected(Scene(str(name))), draw(Scene(str(name)), variant=variant), (k, name, path))


@each_variant
def test_a_picture_of_ones_own_is_not_shared(variant):
    """Two results live side by side."""
    first = draw(Scene("layers"), variant=variant)
    second = draw(Scene("layers", 1), variant=variant)
    assert isinstance(first, Visibility)
    assert_same(expected(Scene("layers")), first)
    assert_same(expected(Scene("layers", 1)), second)
