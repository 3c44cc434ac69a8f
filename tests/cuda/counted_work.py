"""What CUDA kernels that count have to find beside records, entries and fragments: the reference's numbers where they do what its
model does, and bounds on what depends on the order of fragments."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from cases import Case

import bigtri
from bigtri.check.counters import count

Model = Mapping[str, int]


def scanline(case: Case) -> Model:
    """All that the model of the CPU's has of rows and edge values."""
    model = count(*case, variant="scanline", backend="reference")
    return {"rows": model["rows"], "edges_64": model["edges_64"]}


def batched(case: Case) -> Model:
    """Three edge values for each pixel of the bounding boxes, as in the model; but in 64 bits all of them."""
    model = count(*case, variant="batched", backend="reference")
    return {"edges_64": model.get("edges_64", 0) + model.get("edges_32", 0), "edges_32": 0, "wide": 0}


# What each variant does of a case without early reject, and if nothing overflows.
SAME: dict[str, Callable[[Case], Model]] = {"scanline": scanline, "batched": batched}
BY_ATOMICS = ("scanline", "batched")  # each fragment is one atomic minimum on the image


def check(variant: str, counted: Model, case: Case) -> None:
    """Of what a variant has counted of a case, with ``early_z`` 0 and without overflows."""
    wanted = SAME[variant](case)
    assert wanted == {name: counted.get(name, 0) for name in wanted}, variant
    covered = int((bigtri.rasterize(*case).triangle >= 0).sum())
    assert 0 < covered <= counted["passed"] <= counted["fragments"], variant
    if variant in BY_ATOMICS:
        assert (counted["atomics"], counted["written"]) == (counted["fragments"], counted["passed"]), variant


def passed_in_order(case: Case) -> int:
    """Fragments nearer than what their pixel holds where triangles are drawn one after the other."""
    return count(*case, variant="scanline", backend="reference")["passed"]
