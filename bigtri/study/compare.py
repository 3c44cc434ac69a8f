"""Variants side by side on one scene: time, work, and whether each draws what the oracle draws.

`bigtri compare` is the command. The reference draws the scene once. Every variant draws it too, and its picture is compared
in bits. Where one differs, `bigtri.check.verify` finds the first stage that does.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from ..check import counters, registered, sentences, verify
from ..ops.rasterize import Visibility, rasterize
from ..precision import DEFAULT, RUNGS
from .clock import Timing, clock, interleaved, summary


class Job(NamedTuple):
    """A scene, and how it is drawn."""

    positions: NDArray[np.float32]  # [V, 4], clip space
    triangles: NDArray[np.int32]  # [T, 3]
    resolution: tuple[int, int]  # height, width, px
    device: str = "cpu"
    precision: str = DEFAULT
    cull: str = "none"


class Row(NamedTuple):
    """What one variant did."""

    variant: str
    timing: Timing
    differences: list[str]  # the first stage that differs, and the first pixel of the picture; empty if all bits are equal
    counters: dict[str, int]  # of csrc/core/counters.h, those that are not 0; empty where nothing is counted


class Picture(NamedTuple):
    """What ``rasterize`` gives, as NumPy."""

    packed: NDArray[np.int64]  # [H, W]
    depth: NDArray[np.float32]  # [H, W]
    dropped: NDArray[np.int64]  # []


def compare(job: Job, variants: Sequence[str], seconds: float) -> list[Row]:
    """Draw with the reference and with every variant.

    Args:
        variants: of ``bigtri.native.REGISTRY[device][precision]``, or registered ones, which are drawn on the CPU.
        seconds: of the clock, for each variant. All of the extension's take turns.
    """
    own = [variant for variant in variants if variant in registered.registered_variants()]
    compiled = [variant for variant in variants if variant not in own]
    scene = job.positions, job.triangles, job.resolution
    expected = _picture(rasterize(*scene, backend="reference", precision=job.precision, cull=job.cull))
    drawings = {variant: _Drawing(job, variant) for variant in compiled}
    found = {variant: _differences(job, variant, expected, _picture(drawing.draw())) for variant, drawing in drawings.items()}
    ms = interleaved({v: drawing.draw for v, drawing in drawings.items()}, seconds * len(compiled), device=job.device)
    return [*(Row(v, summary(ms[v]), found[v], _counted(job, v)) for v in compiled), *(_own(job, v, seconds) for v in own)]


def _own(job: Job, variant: str, seconds: float) -> Row:
    """A registered variant: its stages one by one, then the whole. Its Python takes no turns, it may need seconds."""
    scene = job.positions, job.triangles, job.resolution
    how: dict[str, Any] = {"precision": job.precision, "cull": job.cull}
    found = list(itertools.islice(verify.differences(*scene, variant=variant, **how), 1))
    ms = clock(lambda: verify.draw(variant, *scene, **how), seconds, warm=0, at_least=1)
    return Row(variant, summary(ms), list(map(str, found)), {})


class _Drawing:
    """A variant's picture, drawn to the same memory every time."""

    def __init__(self, job: Job, variant: str) -> None:
        self.scene = torch.from_numpy(job.positions).to(job.device), torch.from_numpy(job.triangles).to(job.device)
        self.resolution = job.resolution
        self.how: dict[str, Any] = {"variant": variant, "precision": job.precision, "cull": job.cull, "backend": "native"}
        # What no picture has: a pixel that is not written shows.
        self.out = torch.full(job.resolution, -1, dtype=torch.int64, device=job.device)
        self.depth_out = torch.full(job.resolution, -1.0, dtype=torch.float32, device=job.device)

    def draw(self) -> Visibility:
        return rasterize(*self.scene, self.resolution, out=self.out, depth_out=self.depth_out, **self.how)


def _picture(seen: Visibility) -> Picture:
    return Picture(*(torch.as_tensor(image).numpy(force=True) for image in (seen.packed, seen.depth, seen.dropped)))


def _differences(job: Job, variant: str, expected: Picture, seen: Picture) -> list[str]:
    """Where a variant's picture differs from the reference's, in words."""
    found = [
        sentences.packed("rasterize", expected.packed, seen.packed),
        sentences.dropped("rasterize", int(expected.dropped), int(seen.dropped)),
        sentences.depth_image(expected.depth, expected.packed, seen.depth),
    ]
    first_ones = [str(difference) for one in found for difference in itertools.islice(one, 1)]
    if not first_ones:
        return []
    # The stages run on the CPU, whose code for them every device compiles. The whole is the picture that was drawn.
    own = {"rasterize": lambda *_: (seen.packed, seen.dropped)}
    first = verify.compare(job.positions, job.triangles, job.resolution, precision=job.precision, cull=job.cull, stages=own)
    if first is not None and first.stage != "rasterize":
        return [str(first), *first_ones]
    if RUNGS[job.precision].has_stages:
        first_ones.append(f"every stage by itself agrees, so the schedule of variant {variant!r} is at fault")
    return first_ones


def _counted(job: Job, variant: str) -> dict[str, int]:
    """What the build that counts says of the work: there is one for the CPU, of the rungs that are for drawing."""
    if job.device != "cpu":
        return {}
    scene = job.positions, job.triangles, job.resolution
    try:
        return counters.count(*scene, variant=variant, backend="native", precision=job.precision, cull=job.cull)
    except RuntimeError:  # it is not counted; a picture was drawn before, so nothing else is wrong
        return {}
