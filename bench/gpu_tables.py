"""What a person gets on a GPU: the tables of README.md and docs/benchmarks.md, from the rows that `best.py` has measured.

python bench/best.py --device cuda --csv bench/results/cuda_h200_best.csv
python bench/gpu_tables.py bench/results/cuda_h200_best.csv
"""

from __future__ import annotations

import argparse
import statistics
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import markdown
from cuda_cases import AUTO
from cuda_clock import text_of

from bigtri.study import benchmark

ROOT = Path(__file__).resolve().parents[1]
MEMSET = "memset"
SIZES = {"256x256": "256x256", "640x480": "640x480", "1920x1080": "1080p", "3840x2160": "4K"}
SCENES = {
    "R4k": "R4k: a body, seen whole",
    "R16k": "R16k",
    "R16k-close": "the same from near",
    "R16k-far": "the same from far away",
    "R100k": "R100k",
    "R100k-shuffled": "the same in random order",
    "R1M": "R1M",
    "R1M-shuffled": "the same in random order",
    "Rcourtyard": "Rcourtyard: walls, columns and two small meshes",
    "Rterrain": "Rterrain: hills along the ground",
    "Rroom": "Rroom: a room from inside",
}
SHORT = ("R4k", "R16k", "R100k", "R1M", "Rcourtyard", "Rterrain", "Rroom")  # of README.md
BATCHES = {"R4k": "R4k", "R16k": "R16k", "R4k+R16k": "R4k and R16k"}


class Times:
    """Medians in us of what `best.py` has measured, by scene and size or batch."""

    def __init__(self, rows: Iterable[Mapping[str, str]]) -> None:
        self.auto: dict[tuple[str, str], float] = {}
        self.triangles: dict[str, str] = {}
        memsets: dict[str, list[float]] = {}
        for row in rows:
            size = f"{row['width']}x{row['height']}"
            if int(row["views"]) > 1:
                size = f"{row['views']} of {size}"
            if row["variant"] == AUTO.name:
                self.auto[row["scene"], size] = float(row["us_median"])
                self.triangles[row["scene"]] = f"{int(row['triangles']):,}"
            elif row["variant"] == MEMSET:
                memsets.setdefault(size, []).append(float(row["us_median"]))
        self.memset = {size: statistics.median(times) for size, times in memsets.items()}

    def cell(self, scene: str, size: str) -> str:
        return text_of(self.auto[scene, size]) if (scene, size) in self.auto else ""

    def real(self, names: Sequence[str], batch: str | None) -> str:
        """Scenes by size; with a last column for a batch."""
        columns = [*SIZES, *([batch] if batch else [])]
        head = ["", "triangles", *SIZES.values(), *([batch.replace(" of", " views of")] if batch else [])]
        lines = [[SCENES[n], self.triangles[n], *(self.cell(n, size) for size in columns)] for n in names if n in self.triangles]
        return markdown.table(head, [*lines, ["a memset of the image", "", *map(self.memset_cell, columns)]])

    def batches(self) -> str:
        """Batches, with images a second."""
        sizes = list(dict.fromkeys(size for scene, size in self.auto if scene in BATCHES and " of " in size))
        lines = []
        for scene, name in BATCHES.items():
            cells = []
            for size in sizes:
                us = self.auto.get((scene, size))
                cells.append(f"{text_of(us)}, {int(size.split()[0]) / us:.2f}M" if us else "")
            lines.append([name, *cells])
        lines.append(["a memset of the images", *map(self.memset_cell, sizes)])
        return markdown.table(["us, and images a second", *sizes], lines)

    def memset_cell(self, size: str) -> str:
        return text_of(self.memset[size]) if size in self.memset else ""


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("rows", type=Path, nargs="+", metavar="CSV", help="of best.py --device cuda")
    options = parser.parse_args(argv)
    rows = [row for path in options.rows for row in benchmark.read_csv(path)]
    times = Times(rows)
    whence = dict.fromkeys("{device}; torch {torch}; commit {commit}: `{command}`.".format(**row) for row in rows)
    said = "\n".join(markdown.wrapped(line) for line in whence)
    page = ROOT / "docs/benchmarks.md"
    markdown.paste(page, "real meshes cuda", f"{said}\n\n{times.real(list(SCENES), None)}")
    markdown.paste(page, "batches cuda", times.batches())
    markdown.paste(ROOT / "README.md", "real meshes cuda", times.real(SHORT, "64 of 256x256"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
