"""The benchmark: times `bigtri.rasterize` on the scenes of `bigtri.study.scenes`, one CSV row per case.

A case is (scene, resolution, precision, variant, threads, instruction set). What is timed is the whole call, into an
image that exists already: setup, clear, every triangle, packed depth and id. `bigtri bench` is the command; `bench/` has
the drivers that put other rasterizers beside it, which write the same rows.
"""

from __future__ import annotations

import csv
import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar, Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from ..check import stages
from ..ops.rasterize import rasterize
from ..precision import DEFAULT, RUNGS
from ..reference.numerics import BACKGROUND
from . import provenance, scenes
from .clock import Timing, clock, peak_mib, setting, summary

# --- rows


@dataclasses.dataclass
class Row:
    """One case's outcome; the fields are the CSV's columns."""

    renderer: str  # "bigtri", or the peer's name
    variant: str
    precision: str
    effects: str
    scene: str
    triangles: int
    width: int  # px
    height: int  # px
    threads: int
    isa: str
    device: str
    versions: str
    commit: str
    command: str
    ms_median: float = math.nan
    ms_min: float = math.nan
    ms_p25: float = math.nan
    ms_p75: float = math.nan
    repeats: int = 0
    fragments: int | None = None  # covered samples of all triangles, hidden ones too
    covered_px: int | None = None  # pixels with a triangle
    peak_mib: float | None = None  # resident memory above the inputs and the output image
    ratio: float | None = None  # the peer's time over bigtri's in the same rounds, median of the rounds
    ratio_p25: float | None = None
    ratio_p75: float | None = None
    uncovered_px: int | None = None  # of a peer: pixels that only one of the two has covered
    floor_ms: float | None = None  # filling the image and nothing else: median of the same rounds' minima

    def timed(self, timing: Timing) -> Row:
        """This row with a clock's reading."""
        median, minimum, p25, p75, repeats = timing
        return dataclasses.replace(self, ms_median=median, ms_min=minimum, ms_p25=p25, ms_p75=p75, repeats=repeats)


class AnyRow(Protocol):
    """An instance of any dataclass."""

    __dataclass_fields__: ClassVar[dict[str, dataclasses.Field[Any]]]


def write_csv(path: str | Path, rows: Sequence[AnyRow], digits: int = 4) -> None:
    """Writes rows, dataclasses of one kind, under a header, in place of what the file held; floats with so many digits."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        if rows:
            writer.writerow([field.name for field in dataclasses.fields(rows[0])])
        for row in rows:
            values = dataclasses.astuple(row)
            writer.writerow(["" if v is None else f"{v:.{digits}f}" if isinstance(v, float) else v for v in values])


def read_csv(path: str | Path) -> list[dict[str, str]]:
    """The rows of a CSV, as text by column."""
    with Path(path).open(newline="") as file:
        return list(csv.DictReader(file))


# --- cases


def ids(packed: NDArray[np.int64]) -> NDArray[np.int32]:
    """The triangle of each pixel of a packed image, int32 of the same shape; -1 where there is none."""
    return np.where(packed == BACKGROUND, -1, packed & 0xFFFFFFFF).astype(np.int32)


class Job:
    """A scene on the CPU, an output image, and the call to be timed."""

    def __init__(
        self,
        name: str,
        width: int,
        height: int,
        scene: scenes.Triangles,
        variant: str = "auto",
        precision: str = DEFAULT,
    ) -> None:
        self.name, self.width, self.height, self.variant, self.precision = name, width, height, variant, precision
        self.positions = torch.from_numpy(scene.positions)  # [V, 4] float32
        self.triangles = torch.from_numpy(scene.triangles)  # [T, 3] int32
        self.packed = torch.full((height, width), BACKGROUND, dtype=torch.int64)

    def draw(self) -> None:
        size = (self.height, self.width)
        rasterize(
            self.positions,
            self.triangles,
            size,
            variant=self.variant,
            precision=self.precision,
            backend="native",
            out=self.packed,
            depth=False,
        )

    def covered_px(self) -> int:
        """Pixels with a triangle in the last image."""
        return int((self.packed != BACKGROUND).sum())

    def fragments(self) -> int:
        """Covered samples of all triangles: the spans' lengths, every record taken row by row."""
        scene = self.positions.numpy(), self.triangles.numpy()
        backend = "native" if RUNGS[self.precision].has_stages else "reference"
        records, _ = stages.setup(*scene, self.height, self.width, backend=backend, precision=self.precision)
        every = np.arange(len(records.triangle), dtype=np.int32)
        no_queue, no_tiles = np.empty((0, 3), np.int32), np.empty(0, np.int64)
        spans = stages.scanline(records, no_queue, no_tiles, every, backend=backend, precision=self.precision)
        return int((spans[:, 3] - spans[:, 2]).sum(dtype=np.int64))

    def row(self, threads: int, isa: str) -> Row:
        """The case's row before it is timed."""
        return Row(
            renderer="bigtri",
            variant=self.variant,
            precision=self.precision,
            effects="none",
            scene=self.name,
            triangles=len(self.triangles),
            width=self.width,
            height=self.height,
            threads=threads,
            isa=isa,
            device=provenance.device(),
            versions=provenance.versions(),
            commit=provenance.commit(),
            command=provenance.command(),
        )


def measure(job: Job, threads: int, isa: str, seconds: float, fragments: int | None = None) -> Row:
    """Times a job for about `seconds`: a whole row."""
    with setting(threads, isa):
        peak = peak_mib(job.draw)
        timing = summary(clock(job.draw, seconds, at_least=3))
    row = job.row(threads, isa).timed(timing)
    return dataclasses.replace(row, fragments=fragments, covered_px=job.covered_px(), peak_mib=peak)
