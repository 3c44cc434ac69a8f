"""The stages as functions: what they accept, and what they say of what they do not, alike on both backends."""

from __future__ import annotations

import inspect

import numpy as np
import pytest
from backends import BACKENDS
from cases import CASES

from bigtri.check import stages

HEIGHT, WIDTH = 48, 64


@pytest.fixture(params=BACKENDS)
def backend(request):
    return request.param


def arguments() -> dict[str, dict]:
    """Valid arguments of every stage, each fed by the one before."""
    case = CASES["layers"](np.random.default_rng(3))
    positions, triangles = case.positions, case.triangles[:20]
    size = {"height": HEIGHT, "width": WIDTH}
    records, _ = stages.setup(positions, triangles, **size, backend="reference")
    bins = stages.binning(records, 100, backend="reference")
    queue = bins.candidates[bins.kept]
    touched, _ = stages.tile_mask(records, queue, backend="reference")
    spans = stages.scanline(records, queue, touched, bins.small, backend="reference")
    depth = stages.depth(records, spans, backend="reference")
    return {
        "setup": {"positions": positions, "triangles": triangles, **size},
        "binning": {"records": records},
        "tile_mask": {"records": records, "queue": queue},
        "scanline": {"records": records, "queue": queue, "touched": touched, "small": bins.small},
        "depth": {"records": records, "spans": spans},
        "visibility": {"records": records, "spans": spans, "depth": depth, **size},
    }


VALID = arguments()


def test_no_stage_is_missing_here():
    public = {name for name, value in inspect.getmembers(stages, inspect.isfunction) if value.__module__ == stages.__name__}
    assert {name for name in public if not name.startswith("_")} == {*VALID}


def changed(values: np.ndarray, place, value) -> np.ndarray:
    values = values.copy()
    values[place] = value
    return values


def spoiled(stage: str, name: str, how) -> dict:
    """The stage's arguments, one of them (or one of the records' fields) changed by ``how``."""
    given = dict(VALID[stage])
    if name in given:
        return {**given, name: how(given[name])}
    return {**given, "records": given["records"]._replace(**{name: how(getattr(given["records"], name))})}


@pytest.mark.parametrize(
    ("stage", "name", "how", "error", "text"),
    [
        ("setup", "positions", lambda v: v.astype(float), TypeError, "positions must be float32"),
        ("setup", "positions", lambda v: v[:, :3], ValueError, "positions must have size 4"),
        ("setup", "triangles", lambda v: v.astype(np.int64), TypeError, "triangles must be int32"),
        ("setup", "height", lambda _: 16385, ValueError, "height and width must be"),
        ("binning", "xy", lambda v: v[:, :2], ValueError, "xy must have size 3"),
        ("binning", "xy", lambda v: changed(v, 0, 2**23), ValueError, "xy must lie in -8388608 to 8388607"),
        ("tile_mask", "bbox", lambda v: changed(v, (0, 2), 16385), ValueError, "bbox must lie in 0 to 16384"),
        ("tile_mask", "bbox", lambda v: v[1:], ValueError, "bbox must have size"),
        ("tile_mask", "queue", lambda v: v.astype(np.int64), TypeError, "queue must be int32"),
        ("tile_mask", "queue", lambda v: changed(v, (0, 0), -1), ValueError, "queue's records must lie in 0 to"),
        ("scanline", "queue", lambda v: changed(v, (0, 2), 256), ValueError, "queue's bins must lie in 0 to 255"),
        ("scanline", "touched", lambda v: v[1:], ValueError, "touched must have size"),
        ("scanline", "small", lambda v: np.array([10**6], np.int32), ValueError, "small must lie in 0 to"),
        ("depth", "z", lambda v: v.astype(float), TypeError, "z must be float32"),
        ("depth", "area", lambda v: changed(v, 0, 0), ValueError, "area must lie in 1 to"),
        ("depth", "spans", lambda v: changed(v, (0, 0), 10**6), ValueError, "spans' records must lie in 0 to"),
        ("depth", "spans", lambda v: changed(v, (0, 2), v[0, 3] + 1), ValueError, "spans must have lower <= upper, got"),
        ("visibility", "spans", lambda v: changed(v, (0, 1), HEIGHT), ValueError, "spans' rows must lie in 0 to 47"),
        ("visibility", "depth", lambda v: v[1:], ValueError, "depth must have size"),
        ("visibility", "depth", lambda v: changed(v, 0, np.nan), ValueError, "depth must be .0 or more"),
        ("visibility", "depth", lambda v: changed(v, 0, -1), ValueError, "depth must be .0 or more"),
        ("visibility", "depth", lambda v: changed(v, 0, -0.0), ValueError, "depth must be .0 or more"),
        ("visibility", "triangle", lambda v: changed(v, 0, -1), ValueError, "triangle must lie in 0 to"),
        ("visibility", "width", lambda _: 0, ValueError, "height and width must be"),
    ],
)
def test_errors_name_the_argument(stage, name, how, error, text, backend):
    getattr(stages, stage)(**VALID[stage], backend=backend)
    with pytest.raises(error, match=rf"bigtri\.{stage}: {text}"):
        getattr(stages, stage)(**spoiled(stage, name, how), backend=backend)


def test_an_empty_scissor_is_no_missing_one(backend):
    with pytest.raises(ValueError, match=r"bigtri\.setup: scissor must be .*, 4 integers, got \(\)"):
        stages.setup(**VALID["setup"], scissor=(), backend=backend)
    records, _ = stages.setup(**VALID["setup"], scissor=(0, 0, 0, 0), backend=backend)
    assert len(records.triangle) == 0


def test_depth_beyond_the_far_plane_is_dropped(backend):
    given = VALID["visibility"]
    for beyond in (np.float32(1.5), np.float32(np.inf)):
        packed = stages.visibility(**{**given, "depth": np.full_like(given["depth"], beyond)}, backend=backend)
        assert (packed == 2**63 - 1).all()
