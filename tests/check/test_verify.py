"""What ``verify`` says of stages that are broken on purpose, word for word, and what it takes for equal."""

from __future__ import annotations

import collections
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from backends import needs_native
from cases import CASES, from_pixels

from bigtri import native, reference
from bigtri.check import sentences, verify
from bigtri.reference import attributes
from bigtri.reference.records import Bins, Records

# Of the records' four, 0 is large at this threshold, 1 small, and 2 and 3 are the parts that the near plane leaves of triangle 2.
CORNERS = [[[10, 10], [150, 20], [30, 90]], [[70, 70], [76, 70], [70, 77]], [[90, 5], [140, 60], [60, 70]]]
DEPTHS = [[0.25, 0.5, 0.75], [0.5, 0.5, 0.5], [-0.25, 0.5, 0.5]]
CASE = from_pixels(np.array(CORNERS, float), np.array(DEPTHS), (96, 160))
THRESHOLD = 64
BACKGROUND = 2**63 - 1
STAGES: dict[str, Callable[..., Any]] = {
    name: attributes.barycentrics if name == "attributes" else getattr(reference, name) for name in verify._OUTPUTS
}


def compare_with(stage: str, change: Callable[[Any], Any], case=CASE, **options) -> verify.Differences:
    """All differences where ``change`` is made to what the reference's stage returns."""
    own = {stage: lambda *arguments: change(STAGES[stage](*arguments))}
    return verify.compare(*case, every=True, threshold=THRESHOLD, stages=own, **options)


def changed(values: np.ndarray, place: Any, value: Any) -> np.ndarray:
    values = values.copy()
    values[place] = value(values[place]) if callable(value) else value
    return values


def field(name: str, place: Any, value: Any) -> Callable[[Any], Any]:
    """A change of one value in one field of setup's records."""
    return lambda result: (result[0]._replace(**{name: changed(getattr(result[0], name), place, value)}), result[1])


def rows(*indices: int) -> Callable[[Any], Any]:
    """These of setup's records."""
    return lambda result: (Records(*(values[list(indices)] for values in result[0])), result[1])


def listed(*indices: int) -> Callable[[Bins], Bins]:
    """Only these of binning's candidates."""
    return lambda bins: bins._replace(candidates=bins.candidates[list(indices)], kept=bins.kept[list(indices)])


def fragment(depth: float, triangle: int) -> int:
    return int(np.float32(depth).view(np.int32)) << 32 | triangle


BROKEN = [
    ("setup", field("xy", (0, 1, 1), 5121), "triangle 0: vertex 1 snapped to (38400, 5121) subpx, (38400, 5120) expected"),
    ("setup", field("z", (1, 2), np.nextafter(np.float32(0.5), 1)), "triangle 1: vertex 2 at depth 0.50000006, 0.5 expected"),
    ("setup", field("area", 1, 2752513), "triangle 1: twice the area is 2752513 subpx^2, 2752512 expected"),
    ("setup", field("bbox", (2, 3), 71), "triangle 2 (part 1 of 2): bbox (60, 23, 107, 71) px, (60, 23, 107, 70) expected"),
    ("setup", field("w", (3, 1), 0.875), "triangle 2 (part 2 of 2): vertex 1 has w = 0.875, 0.75 expected"),
    ("setup", field("corner", (1, 0), 1), "triangle 1: vertex 0 is corner 1 of the triangle, 0 expected"),
    ("setup", field("corner", (2, 0), 1), "triangle 2 (part 1 of 2): slot 0 is corner 1 of the triangle, 2 expected"),
    (
        "setup",
        field("weights", (3, 0, 1), -0.0),
        "triangle 2 (part 2 of 2): vertex 0 has the weights (1.0, -0.0, 0.0) of the slots, (1.0, 0.0, 0.0) expected",
    ),
    ("setup", field("clipped", 0, True), "triangle 0: clipped, not clipped expected"),
    ("setup", lambda result: (result[0], 2), "2 triangles dropped, 0 expected"),
    ("setup", lambda result: (result[0], 1), "1 triangle dropped, 0 expected"),
    ("setup", rows(0, 2, 3), "triangle 1: no record, 1 expected"),
    ("setup", rows(0, 1, 2, 2, 3), "triangle 2: 3 records, 2 expected"),
    ("setup", rows(0, 2, 3, 1), "triangle 1: its record follows one of triangle 2, ascending order expected"),
    ("setup", rows(0, 1, 2, 3, 3, 3), "triangle 2: 4 records, 2 expected"),
    (
        "binning",
        lambda bins: bins._replace(small=bins.small[:0]),
        "triangle 1, with 42 px of bbox at a threshold of 64: not small, small expected",
    ),
    (
        "binning",
        lambda bins: bins._replace(small=np.array([1, 2, 2], np.int32)),
        "triangle 2 (part 1 of 2), with 2209 px of bbox at a threshold of 64: small twice, not small expected",
    ),
    (
        "binning",
        lambda bins: bins._replace(small=np.array([1, 1, 1], np.int32)),
        "triangle 1, with 42 px of bbox at a threshold of 64: small 3 times, small once expected",
    ),
    ("binning", lambda bins: bins._replace(kept=changed(bins.kept, 2, False)), "triangle 0, bin (2, 0): rejected, kept expected"),
    ("binning", lambda bins: bins._replace(kept=changed(bins.kept, 5, True)), "triangle 0, bin (2, 1): kept, rejected expected"),
    ("binning", listed(*range(1, 16)), "triangle 0, bin (0, 0): not a candidate, kept expected"),
    ("binning", listed(*range(15), 14, 15), "triangle 2 (part 2 of 2), bin (1, 1): kept twice, kept once expected"),
    ("binning", listed(5, *range(16)), "triangle 0, bin (2, 1): rejected twice, rejected once expected"),
    (
        "binning",
        lambda bins: Bins(bins.candidates[[0, *range(16)]], changed(bins.kept[[0, *range(16)]], 0, False), bins.small),
        "triangle 0, bin (0, 0): kept once and rejected once, kept once expected",
    ),
    (
        "binning",
        lambda bins: Bins(
            np.concatenate([bins.candidates, [[9, 4, 5]]]).astype(np.int32), np.append(bins.kept, True), bins.small
        ),
        "record 9 (there are 4), bin (4, 5): kept, not a candidate expected",
    ),
    (
        "tile_mask",
        lambda masks: (changed(masks[0], 0, lambda mask: mask ^ 1 << 9), masks[1]),
        "triangle 0, bin (0, 0), tile (1, 1): not touched, touched expected",
    ),
    (
        "tile_mask",
        lambda masks: (masks[0], changed(masks[1], 0, lambda mask: mask ^ 1 << 36)),
        "triangle 0, bin (0, 0), tile (4, 4): touched, full expected",
    ),
    (
        "tile_mask",
        lambda masks: (masks[0], changed(masks[1], 0, lambda mask: mask ^ np.int64(-(2**63)))),
        "triangle 0, bin (0, 0), tile (7, 7): touched, full expected",
    ),
    (
        "tile_mask",
        lambda masks: (masks[0], changed(masks[1], 0, lambda mask: mask ^ 1)),
        "triangle 0, bin (0, 0), tile (0, 0): full but not touched, not touched expected",
    ),
    ("scanline", lambda spans: spans[1:], "pixels (10, 10) to (15, 10): not covered by triangle 0, covered expected"),
    (
        "scanline",
        lambda spans: spans[[0, *range(len(spans))]],
        "pixels (10, 10) to (15, 10): covered twice by triangle 0, covered once expected",
    ),
    ("scanline", lambda spans: changed(spans, (0, 2), 11), "pixel (10, 10): not covered by triangle 0, covered expected"),
    (
        "scanline",
        lambda spans: changed(spans, (-1, 3), lambda x: x + 1),
        "pixel (71, 75): covered by triangle 1, not covered expected",
    ),
    (
        "scanline",
        lambda spans: np.concatenate([spans, [[9, 3, 1, 3]]]).astype(np.int32),
        "pixels (1, 3) to (2, 3): covered by record 9 (there are 4), not covered expected",
    ),
    (
        "depth",
        lambda depth: changed(depth, 700, lambda z: np.nextafter(z, np.float32(1))),
        "pixel (20, 31): triangle 0 at depth 0.39136368, 0.39136365 expected",
    ),
    (
        "visibility",
        lambda packed: changed(packed, (1, 5), fragment(0.598, 35)),
        "pixel (5, 1): triangle 35 at depth 0.598, background expected",
    ),
    (
        "visibility",
        lambda packed: changed(packed, (20, 40), BACKGROUND),
        "pixel (40, 20): background, triangle 0 at depth 0.35363635 expected",
    ),
    (
        "visibility",
        lambda packed: changed(packed, (20, 40), lambda value: value + (1 << 32)),
        "pixel (40, 20): triangle 0 at depth 0.35363638, triangle 0 at depth 0.35363635 expected",
    ),
    (
        "visibility",
        lambda packed: changed(packed, (1, 5), BACKGROUND - 1),
        "pixel (5, 1): 0x7ffffffffffffffe (no triangle with a depth), background expected",
    ),
    (
        "visibility",
        lambda packed: changed(packed, (1, 5), -1),
        "pixel (5, 1): 0xffffffffffffffff (no triangle with a depth), background expected",
    ),
    (
        "rasterize",
        lambda result: (changed(result[0], (20, 140), fragment(0.25, 2)), result[1]),
        "pixel (140, 20) in tile (1, 2) of bin (2, 0): triangle 2 at depth 0.25, triangle 0 at depth 0.49 expected",
    ),
    ("rasterize", lambda result: (result[0], result[1] + 1), "1 triangle dropped, 0 expected"),
    (
        "attributes",
        lambda weights: changed(weights, (20, 40, 1), 0.25),
        "pixel (40, 20): triangle 0 has the barycentrics (0.69136363, 0.25, 0.105909094), "
        "(0.69136363, 0.20272727, 0.105909094) expected",
    ),
    (
        "attributes",
        lambda weights: changed(weights, (0, 0, 2), -0.0),
        "pixel (0, 0): background has the barycentrics (0.0, 0.0, -0.0), (0.0, 0.0, 0.0) expected",
    ),
]


def test_every_stage_has_a_sentence():
    """One that is not broken above could differ unseen."""
    assert {stage for stage, *_ in BROKEN} == {*STAGES}


@pytest.mark.parametrize(("stage", "change", "sentence"), BROKEN)
def test_the_whole_sentence(stage, change, sentence):
    assert [str(found) for found in compare_with(stage, change)] == [f"stage {stage}, {sentence}"]


def test_the_place_is_told_in_numbers_too():
    """For programs; the values are those of the outputs."""
    found = compare_with("setup", field("xy", (3, 1, 1), 0))[0]
    assert (found.what, found.expected, found.got, found.triangle) == ("xy", (27307, 5973), (27307, 0), 2)
    found = compare_with("binning", lambda bins: bins._replace(kept=changed(bins.kept, 2, False)))[0]
    assert (found.what, found.expected, found.got, found.triangle, found.bin) == ("kept", "kept", "rejected", 0, (2, 0))
    found = compare_with("tile_mask", lambda masks: (masks[0], changed(masks[1], 1, lambda mask: mask ^ 1 << 11)))[0]
    assert (found.what, found.triangle, found.bin, found.tile) == ("full", 0, (1, 0), (3, 1))
    found = compare_with("visibility", lambda packed: changed(packed, (75, 139), fragment(0.5, 1)))[0]
    assert found[1:4] == ("packed", BACKGROUND, fragment(0.5, 1))
    assert found[5:] == (1, (2, 1), (1, 1), (139, 75))


@pytest.mark.parametrize(("value", "triangle"), [(fragment(0.75, 7), 0), (fragment(0.125, 7), 7), (BACKGROUND, 0)])
def test_the_nearer_triangle_is_at_fault(value, triangle):
    """It should not be there, or it should not be missing."""
    assert compare_with("visibility", lambda packed: changed(packed, (20, 40), value))[0].triangle == triangle


def test_nothing_is_reported_of_stages_that_agree():
    assert verify.compare(*CASE, stages=STAGES, threshold=THRESHOLD) is None
    assert str(verify.compare(*CASE, stages=STAGES, threshold=THRESHOLD, every=True)) == "no difference"


def test_a_scene_without_triangles():
    """And what is there all the same."""
    case = (CASE.positions[:0], CASE.triangles[:0], CASE.resolution)
    assert verify.compare(*case, stages=STAGES) is None
    assert verify.compare(*case, stages={"attributes": STAGES["attributes"]}) is None

    drawn = reference.setup(*CASE[:2], *CASE.resolution)[0]
    found = verify.compare(*case, stages={"setup": lambda *_: (drawn, 0)}, every=True)
    assert list(map(str, found)) == [
        "stage setup, triangle 0: 1 record, none expected",
        "stage setup, triangle 1: 1 record, none expected",
        "stage setup, triangle 2: 2 records, none expected",
    ]
    found = verify.compare(
        *case, stages={"binning": lambda *_: Bins(np.zeros((0, 3), np.int32), np.zeros(0, bool), np.array([5], np.int32))}
    )
    assert str(found) == "stage binning, record 5 (there are 0): small, not small expected"


@pytest.mark.parametrize("name", ["screen_size", "behind_camera", "many_small", "not_finite"])
def test_order_and_cuts_are_no_difference(name):
    """The queue in any order; spans in any order, and cut anywhere: whole rows, single pixels."""
    case = CASES[name](np.random.default_rng(2))
    rng = np.random.default_rng(3)

    def shuffled(*arguments):
        bins = reference.binning(*arguments)
        order = rng.permutation(len(bins.kept))
        return Bins(bins.candidates[order], bins.kept[order], rng.permutation(bins.small))

    def pixels(*arguments):
        spans = reference.scanline(*arguments)
        length = spans[:, 3] - spans[:, 2]
        single = np.repeat(spans, length, axis=0)
        single[:, 2] += np.arange(len(single)) - np.repeat(np.cumsum(length) - length, length)
        single[:, 3] = single[:, 2] + 1
        return rng.permutation(single)

    own = {"binning": shuffled, "scanline": pixels}
    assert not verify.compare(*case, threshold=THRESHOLD, stages=own, every=True)


def test_coverage_is_counted_pixel_by_pixel():
    """Spans lost, doubled, moved and cut: what is said of the pieces, added up over pixels, is what a count of them gives."""
    rng = np.random.default_rng(4)
    case = CASES["many_small"](rng)
    counts = []

    def spoiled(*arguments):
        right = reference.scanline(*arguments)
        wrong = right[rng.choice(len(right), len(right))]
        wrong[::3, 2:] += rng.integers(-4, 5, (len(wrong[::3]), 1)).astype(np.int32)
        for spans in (right, wrong):
            counts.append(collections.Counter((r, y, x) for r, y, low, end in spans.tolist() for x in range(low, end)))
        return wrong

    records, _ = reference.setup(*case[:2], *case.resolution)
    found = [
        d for d in verify.compare(*case, threshold=THRESHOLD, stages={"scanline": spoiled}, every=True) if d.stage == "scanline"
    ]
    expected, got = counts
    wanted = collections.Counter()
    for key in expected.keys() | got.keys():
        if expected[key] != got[key]:
            r, y, x = key
            wanted[int(records.triangle[r]), (x, y), expected[key], got[key]] += 1
    said = collections.Counter()
    for d in found:
        end = int(str(d).split(" to (")[1].split(",")[0]) if " to (" in str(d) else d.pixel[0]
        for x in range(d.pixel[0], end + 1):
            said[d.triangle, (x, d.pixel[1]), d.expected, d.got] += 1
    assert said == wanted
    assert len(wanted) > 1000


def test_one_fault_does_not_shift_what_follows():
    """A record lost in the middle of many: that, and not that every later record is another one."""
    case = CASES["many_small"](np.random.default_rng(5))
    found = compare_with(
        "setup", lambda result: (Records(*(np.delete(values, 300, axis=0) for values in result[0])), result[1]), case
    )
    triangle = int(reference.setup(*case[:2], *case.resolution)[0].triangle[300])
    assert [str(difference) for difference in found] == [f"stage setup, triangle {triangle}: no record, 1 expected"]


def test_all_differences_and_a_text_of_bounded_length():
    found = compare_with("depth", lambda depth: depth + np.float32(1))
    records, _ = reference.setup(*CASE[:2], *CASE.resolution)
    everything = STAGES["scanline"](records, np.zeros((0, 3), np.int32), np.zeros(0, np.int64), np.arange(4, dtype=np.int32))
    pixels = int((everything[:, 3] - everything[:, 2]).sum())
    assert len(found) == pixels
    lines = str(found).split("\n")
    assert lines[0] == "stage depth, pixel (10, 10): triangle 0 at depth 1.2536364, 0.25363636 expected"
    assert lines[5:] == [f"stage depth, {pixels - 5} more differences"]


def test_every_stage_with_a_difference_is_in_the_list():
    def moved(records, *arguments):
        return reference.depth(records, *arguments) + np.float32(1)

    own = {
        "binning": lambda *arguments: reference.binning(*arguments)._replace(small=np.zeros(0, np.int32)),
        "depth": moved,
        "rasterize": lambda *arguments: (changed(reference.rasterize(*arguments)[0], (0, 0), 7), 0),
    }
    found = verify.compare(*CASE, threshold=THRESHOLD, stages=own, every=True)
    assert list(dict.fromkeys(difference.stage for difference in found)) == ["binning", "depth", "rasterize"]
    assert verify.compare(*CASE, threshold=THRESHOLD, stages=own) == found[0]
    assert "fault" not in str(found[-1])  # the stages do not agree


def test_stages_run_when_their_turn_comes():
    ran = []

    def running(stage):
        def run(*arguments):
            ran.append(stage)
            result = STAGES[stage](*arguments)
            return result._replace(small=result.small[:0]) if stage == "binning" else result

        return run

    found = verify.differences(*CASE, threshold=THRESHOLD, stages={stage: running(stage) for stage in STAGES})
    assert not ran
    assert next(found).stage == "binning"
    assert ran == ["setup", "binning"]
    assert list(found) == []
    assert ran == list(STAGES)


def test_one_s_own_stage_may_write_to_its_arguments():
    def greedy(stage):
        def run(*arguments):
            result = STAGES[stage](*arguments)
            for value in arguments:
                for array in value if isinstance(value, Records) else [value] if isinstance(value, np.ndarray) else []:
                    array[...] = 0
            return result

        return run

    assert not verify.compare(*CASE, threshold=THRESHOLD, stages={stage: greedy(stage) for stage in STAGES}, every=True)
    assert np.abs(CASE.positions).sum() > 0


def test_torch_in_and_out():
    """Tensors as input, and stages that return them."""

    def as_tensors(stage):
        def convert(result):
            if isinstance(result, np.ndarray):
                return torch.from_numpy(result)
            return tuple(map(convert, result)) if isinstance(result, tuple) else torch.tensor(result)

        return lambda *arguments: convert(STAGES[stage](*arguments))

    positions, triangles = torch.from_numpy(CASE.positions).requires_grad_(), torch.from_numpy(CASE.triangles)
    own = {stage: as_tensors(stage) for stage in STAGES}
    assert verify.compare(positions, triangles, CASE.resolution, stages=own, threshold=THRESHOLD) is None


def test_scissor_and_culling_reach_one_s_own_stages():
    got = []

    def setup(*arguments):
        got.append(arguments[2:])
        return reference.setup(*arguments)

    assert (
        verify.compare(*CASE, cull="front", scissor=(-5, 4, 300, 50), stages={"setup": setup, "rasterize": reference.rasterize})
        is None
    )
    assert got == [(96, 160, "front", (0, 4, 160, 50))]


@pytest.mark.parametrize(
    ("stages", "error", "text"),
    [
        ({"bining": len}, ValueError, "stages must be named 'setup', 'binning', .*'rasterize', 'attributes', got 'bining'"),
        ({"binning": None}, TypeError, r"stages\['binning'\] must be callable, got None"),
        ([reference.binning], TypeError, "stages must map some of 'setup', .* to callables, got list"),
        ({"binning": lambda *_: None}, TypeError, "stage binning must return a tuple of candidates, kept, small, got None"),
        ({"tile_mask": lambda *_: (1, 2, 3)}, TypeError, "stage tile_mask must return a tuple of touched, full, got 3 values"),
        (
            {"setup": lambda *_: np.zeros(3)},
            TypeError,
            "stage setup must return a tuple of records, dropped, got float64 \\[3\\]",
        ),
        (
            {"setup": lambda *_: ((1, 2), 0)},
            TypeError,
            "stage setup must return records as a tuple of triangle, xy, .*clipped, got 2 values",
        ),
        (
            {"setup": lambda *a: (reference.setup(*a)[0], 0.5)},
            TypeError,
            r"stage setup must return dropped as int64 \[\], got 0.5",
        ),
        (
            {"setup": lambda *a: field("z", 0, 0.5)(reference.setup(*a))[0:1] + (True,)},
            TypeError,
            r"stage setup must return dropped as int64 \[\], got True",
        ),
        (
            {"setup": lambda *a: (reference.setup(*a)[0]._replace(w=np.ones((5, 3))), 0)},
            ValueError,
            r"stage setup must return w as float64 \[N, 3\] with N = 4, got float64 \[5, 3\]",
        ),
        (
            {"binning": lambda *a: reference.binning(*a)._replace(kept=np.ones(3, bool))},
            ValueError,
            r"stage binning must return kept as bool \[C\] with C = 16, got bool \[3\]",
        ),
        (
            {"binning": lambda *a: reference.binning(*a)._replace(kept=np.ones(16, np.int32))},
            TypeError,
            r"stage binning must return kept as bool \[C\] with C = 16, got int32 \[16\]",
        ),
        (
            {"tile_mask": lambda records, queue: (np.zeros(3, np.int64),) * 2},
            ValueError,
            r"stage tile_mask must return touched as int64 \[Q\] with Q = \d+, got int64 \[3\]",
        ),
        ({"scanline": lambda *_: [[0, 0, 0, 1]]}, TypeError, r"stage scanline must return spans as int32 \[S, 4\], got list"),
        (
            {"scanline": lambda *_: np.zeros((2, 3), np.int32)},
            ValueError,
            r"stage scanline must return spans as int32 \[S, 4\], got int32 \[2, 3\]",
        ),
        (
            {"scanline": lambda *_: np.array([[0, 4, 9, 8]], np.int32)},
            ValueError,
            r"stage scanline must return spans with lower <= upper, got \[0, 4, 9, 8\]",
        ),
        (
            {"depth": lambda records, spans: np.zeros(len(spans), np.float32)},
            ValueError,
            r"stage depth must return depth as float32 \[F\] with F = \d+, got float32 \[\d+\]",
        ),
        (
            {"depth": lambda *a: reference.depth(*a).astype(float)},
            TypeError,
            r"stage depth must return depth as float32 \[F\] with F = \d+, got float64 \[\d+\]",
        ),
        (
            {"visibility": lambda *a: reference.visibility(*a).T},
            ValueError,
            r"stage visibility must return packed as int64 \[H, W\] with H = 96 and W = 160, got int64 \[160, 96\]",
        ),
        (
            {"rasterize": lambda *a: reference.rasterize(*a)[0]},
            TypeError,
            r"stage rasterize must return a tuple of packed, dropped, got int64 \[96, 160\]",
        ),
        (
            {"attributes": lambda packed, *_: packed},
            TypeError,
            r"stage attributes must return barycentrics as float32 \[H, W, 3\] with H = 96 and W = 160, got int64 \[96, 160\]",
        ),
        ({"tile_mask": lambda records: records}, RuntimeError, r"stages\['tile_mask'\] raised TypeError: .*positional"),
    ],
)
def test_what_is_no_stage_is_refused(stages, error, text):
    with pytest.raises(error, match="^bigtri.verify: " + text):
        verify.compare(*CASE, stages=stages, threshold=THRESHOLD)


def test_what_a_stage_raises_is_passed_on():
    def broken(*_):
        raise LookupError("nothing there")

    with pytest.raises(RuntimeError, match=r"^bigtri.verify: stages\['depth'\] raised LookupError: nothing there$") as caught:
        verify.compare(*CASE, stages={"depth": broken})
    assert isinstance(caught.value.__cause__, LookupError)


@pytest.mark.parametrize(
    ("options", "error", "text"),
    [
        ({"every": 1}, TypeError, "bigtri.verify.compare: every must be True or False, got 1"),
        ({"cull": "all"}, ValueError, "bigtri.verify: cull must be one of 'none', 'back', 'front', got 'all'"),
        ({"variant": "fast"}, ValueError, "bigtri.verify: variant must be one of 'auto'.*, got 'fast'"),
        ({"precision": "best"}, ValueError, "bigtri.verify: precision must be one of 'exact'.*, got 'best'"),
        ({"scissor": (1, 2, 3)}, ValueError, "bigtri.verify: scissor must be"),
    ],
)
def test_options_are_checked_before_anything_runs(options, error, text):
    def never(*_):
        raise AssertionError

    with pytest.raises(error, match=text):
        verify.compare(*CASE, stages=dict.fromkeys(STAGES, never), **options)


def test_without_the_extension_only_one_s_own_stages_are_compared(monkeypatch):
    monkeypatch.setattr(native, "available", lambda: False)
    with pytest.raises(RuntimeError, match="bigtri.verify: backend='native' needs the extension"):
        verify.compare(*CASE)
    assert verify.compare(*CASE, stages={"binning": reference.binning}) is None
    found = compare_with("depth", lambda depth: changed(depth, 0, 2))
    assert [difference.stage for difference in found] == ["depth"]


def with_image(monkeypatch, change):
    """The extension's ``rasterize`` as it is used by ``verify``, its outcome changed."""
    real = verify.rasterize

    def drawn(*arguments, backend, **options):
        seen = real(*arguments, backend=backend, **options)
        return change(seen) if backend == "native" else seen

    monkeypatch.setattr(verify, "rasterize", drawn)


@needs_native
@pytest.mark.parametrize("variant", ["auto", *native.VARIANTS.get("cpu", ())])
def test_a_schedule_is_at_fault_where_no_stage_is(monkeypatch, variant):
    name = native.VARIANTS["cpu"][0] if variant == "auto" else variant
    blame = f"; every stage by itself agrees, so the schedule of variant {name!r} is at fault"
    where = "stage rasterize, pixel (140, 20) in tile (1, 2) of bin (2, 0): "
    with_image(monkeypatch, lambda seen: seen._replace(packed=changed(seen.packed, (20, 140), BACKGROUND)))
    found = verify.compare(*CASE, variant=variant)
    assert str(found) == where + "background, triangle 0 at depth 0.49 expected" + blame
    assert (found.triangle, found.bin, found.tile, found.pixel) == (0, (2, 0), (1, 2), (140, 20))


@needs_native
def test_a_schedule_that_loses_the_count_or_the_depth_image(monkeypatch):
    blame = f"; every stage by itself agrees, so the schedule of variant {native.VARIANTS['cpu'][0]!r} is at fault"
    with_image(monkeypatch, lambda seen: seen._replace(dropped=seen.dropped + 1, depth=changed(seen.depth, (20, 140), 1)))
    where = "pixel (140, 20) in tile (1, 2) of bin (2, 0): "
    assert [str(found) for found in verify.compare(*CASE, every=True)] == [
        f"stage rasterize, 1 triangle dropped, 0 expected{blame}",
        f"stage rasterize, {where}triangle 0 at depth 0.49, but 1.0 in the depth image, 0.49 expected{blame}",
    ]


@needs_native
def test_a_rung_is_compared_with_its_own_reference(monkeypatch):
    """Each stage too: one that computes by another rung's arithmetic is found."""
    assert verify.compare(*CASE, precision="subpixel4", threshold=THRESHOLD) is None
    real = verify.one_stage.setup
    with_exact = {"native": "exact", "reference": "subpixel4"}
    monkeypatch.setattr(
        verify.one_stage, "setup", lambda *a, backend, precision: real(*a, backend=backend, precision=with_exact[backend])
    )
    found = verify.compare(*CASE, precision="subpixel4")
    assert str(found) == "stage setup, triangle 0: vertex 0 snapped to (2560, 2560) subpx, (160, 160) expected"


@needs_native
def test_an_output_of_the_extension_s_of_another_length(monkeypatch):
    real = verify.one_stage.depth
    monkeypatch.setattr(verify.one_stage, "depth", lambda *a, **how: real(*a, **how)[how["backend"] == "native" :])
    with pytest.raises(ValueError, match=r"^bigtri.verify: stage depth must return depth as float32 \[F\] with F = 7701, got"):
        verify.compare(*CASE)


@needs_native
def test_no_schedule_is_blamed_whose_stages_were_not_all_compared(monkeypatch):
    with_image(monkeypatch, lambda seen: seen._replace(dropped=seen.dropped + 1))
    found = verify.compare(*CASE, stages={"depth": reference.depth})
    assert str(found) == "stage rasterize, 1 triangle dropped, 0 expected"


def test_one_s_own_schedule_is_at_fault_where_one_s_own_stages_are_not():
    own = STAGES | {"rasterize": lambda *arguments: (reference.rasterize(*arguments)[0], 1)}
    found = verify.compare(*CASE, stages=own)
    blame = "; every stage by itself agrees, so the schedule of stages['rasterize'] is at fault"
    assert str(found) == "stage rasterize, 1 triangle dropped, 0 expected" + blame


def test_equal_in_bits():
    """-0 is not 0, but which NaN it is does not matter."""
    a = np.array([0.0, 1.0, np.nan, np.nan, np.inf], np.float32)
    b = np.array([-0.0, 1.0, np.nan, 0.0, np.inf], np.float32)
    b.view(np.uint32)[2] ^= 0x80000001
    assert sentences.same_bits(a, b).tolist() == [False, True, True, False, True]
