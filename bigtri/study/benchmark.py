"""The benchmark's clock: times `bigtri.rasterize` on the scenes of `bigtri.study.scenes`, one CSV row per case.

A case is (scene, resolution, threads, instruction set, variant). The clock warms up, then repeats until the case's time is
spent, and reports median, minimum and quartiles: on a shared machine the minimum is what the code can do, the distance between
the quartiles how far to trust the median. What is timed is the whole call, into an image that exists already: setup, clear,
every triangle, packed depth and id. `bench/` has the drivers that put other rasterizers beside it; they write the same rows.
"""

from __future__ import annotations

import argparse
import csv
import dataclasses
import itertools
import math
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..app import info
from ..reference.numerics import BACKGROUND, MAX_SIZE
from . import scenes

MAX_THREADS = 1024  # beyond, systems refuse to start them, and then the process ends
T = TypeVar("T")
DEFAULT_SCENES = "S1,S2,S3,S4f,S4b,S5,S6-200k"


# --- the clock


class Timing(NamedTuple):
    """Milliseconds per call."""

    median: float
    minimum: float
    p25: float
    p75: float
    repeats: int


def summary(ms: Sequence[float]) -> Timing:
    p25, median, p75 = np.percentile(ms, [25, 50, 75])
    return Timing(float(median), float(min(ms)), float(p25), float(p75), len(ms))


def clock(call: Callable[[], object], seconds: float, warm: int = 2, at_least: int = 5, at_most: int = 1000) -> list[float]:
    """Milliseconds of each call, for about `seconds` but at least `at_least` calls, after `warm` calls that do not count."""
    for _ in range(warm):
        call()
    ms: list[float] = []
    end = time.perf_counter() + seconds
    while len(ms) < at_least or (time.perf_counter() < end and len(ms) < at_most):
        start = time.perf_counter()
        call()
        ms.append((time.perf_counter() - start) * 1e3)
    return ms


def peak_mib(call: Callable[[], object]) -> float | None:
    """How far the resident memory rises above where it was during `call`, MiB; None where the system cannot say.

    Measured on a first call, before scratch memory is kept for reuse.
    """

    def resident(field: str) -> int:  # KiB
        return int(next(line for line in status.read_text().splitlines() if line.startswith(field)).split()[1])

    status = Path("/proc/self/status")
    try:
        Path("/proc/self/clear_refs").write_text("5")  # resets VmHWM, the high-water mark (Linux)
        before = resident("VmRSS")
    except (OSError, StopIteration):
        call()
        return None
    call()
    return max(0, resident("VmHWM") - before) / 1024


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


def device() -> str:
    """The CPU's name and how many of its cores this process may use."""
    return f"{info.cpu_name()}, {info.usable_cpus()} cores"


def versions() -> str:
    import torch

    import bigtri

    return f"bigtri {bigtri.__version__}; torch {torch.__version__}; numpy {np.__version__}; python {platform.python_version()}"


def commit() -> str:
    """The checkout's commit, with -dirty where files differ from it; empty outside a checkout."""
    describe = ["git", "describe", "--always", "--dirty", "--exclude=*"]
    try:
        return subprocess.run(describe, cwd=Path(__file__).parent, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return ""


def command() -> str:
    """This process's command line, without the folder of the program."""
    program = Path(sys.argv[0]).name
    return " ".join(["python -m bigtri" if program == "__main__.py" else program, *sys.argv[1:]])


# --- cases


def ids(packed: NDArray[np.int64]) -> NDArray[np.int32]:
    """The triangle of each pixel of a packed image, int32 of the same shape; -1 where there is none."""
    return np.where(packed == BACKGROUND, -1, packed & 0xFFFFFFFF).astype(np.int32)


class Job:
    """A scene on the CPU, an output image, and the call to be timed."""

    def __init__(self, name: str, width: int, height: int, scene: scenes.Triangles, variant: str = "auto") -> None:
        import torch

        self.name, self.width, self.height, self.variant = name, width, height, variant
        self.positions = torch.from_numpy(scene.positions)  # [V, 4] float32
        self.triangles = torch.from_numpy(scene.triangles)  # [T, 3] int32
        self.packed = torch.full((height, width), BACKGROUND, dtype=torch.int64)

    def draw(self) -> None:
        import bigtri

        size = (self.height, self.width)
        bigtri.rasterize(
            self.positions, self.triangles, size, backend="native", variant=self.variant, out=self.packed, depth=False
        )

    def covered_px(self) -> int:
        """Pixels with a triangle in the last image."""
        return int((self.packed != BACKGROUND).sum())

    def fragments(self) -> int:
        """Covered samples of all triangles: the spans' lengths, every record taken row by row."""
        from ..check import stages

        scene = self.positions.numpy(), self.triangles.numpy()
        records, _ = stages.setup(*scene, self.height, self.width, backend="native")
        every = np.arange(len(records.triangle), dtype=np.int32)
        no_queue, no_tiles = np.empty((0, 3), np.int32), np.empty(0, np.int64)
        spans = stages.scanline(records, no_queue, no_tiles, every, backend="native")
        return int((spans[:, 3] - spans[:, 2]).sum(dtype=np.int64))

    def row(self, threads: int, isa: str) -> Row:
        """The case's row before it is timed."""
        return Row(
            renderer="bigtri",
            variant=self.variant,
            precision="exact",
            effects="none",
            scene=self.name,
            triangles=len(self.triangles),
            width=self.width,
            height=self.height,
            threads=threads,
            isa=isa,
            device=device(),
            versions=versions(),
            commit=commit(),
            command=command(),
        )


@contextmanager
def setting(threads: int, isa: str | None = None) -> Iterator[None]:
    """torch's thread count and bigtri's instruction set for a while."""
    import torch

    from .. import native

    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        with native.using_isa(isa or native.isa()):
            yield
    finally:
        torch.set_num_threads(before)


def measure(job: Job, threads: int, isa: str, seconds: float, fragments: int | None = None) -> Row:
    """Times a job for about `seconds`: a whole row."""
    with setting(threads, isa):
        peak = peak_mib(job.draw)
        timing = summary(clock(job.draw, seconds, at_least=3))
    row = job.row(threads, isa).timed(timing)
    return dataclasses.replace(row, fragments=fragments, covered_px=job.covered_px(), peak_mib=peak)


# --- the command


def whole(low: int, high: int | None = None) -> Callable[[str], int]:
    """An argparse type: a whole number of at least `low` and at most `high`."""
    wanted = f"a whole number of at least {low}" if high is None else f"a whole number from {low} to {high}"

    def parse(text: str) -> int:
        # int() refuses a number of thousands of digits, with an error of its own.
        number = int(text) if text.isdecimal() and len(text) < 20 else -1
        if number < low or (high is not None and number > high):
            raise argparse.ArgumentTypeError(f"must be {wanted}, got {text!r}")
        return number

    return parse


def size(text: str) -> tuple[int, int]:
    """An argparse type: (width, height) in px, 1 to `MAX_SIZE` each, from "1920x1080" or from a name."""
    named = {"1080p": "1920x1080", "4k": "3840x2160", "8k": "7680x4320", "16k": "15360x8640"}.get(text.lower(), text)
    width, _, height = named.lower().partition("x")
    try:
        return whole(1, MAX_SIZE)(width), whole(1, MAX_SIZE)(height)
    except argparse.ArgumentTypeError:
        wanted = f"WIDTHxHEIGHT, 1 to {MAX_SIZE} each, such as 1920x1080, or 1080p, 4k, 8k, 16k"
        raise argparse.ArgumentTypeError(f"must be {wanted}, got {text!r}") from None


def seconds(text: str) -> float:
    """An argparse type: a time in seconds."""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not 0 <= number < math.inf:
        raise argparse.ArgumentTypeError(f"must be a number of seconds of at least 0, got {text!r}")
    return number


def csv_file(text: str) -> Path:
    """An argparse type: a file that can be written, as far as can be said before there is anything to write."""
    path = Path(text)
    there = next(folder for folder in (path, *path.absolute().parents) if os.path.lexists(folder))
    if os.path.isdir(path) or not path.name:
        raise argparse.ArgumentTypeError(f"must be a file, got the folder {text!r}")
    if there != path and not there.is_dir():
        raise argparse.ArgumentTypeError(f"must be in a folder, got {text!r}: {there} is a file")
    if not os.access(there, os.W_OK):
        raise argparse.ArgumentTypeError(f"must be a file that can be written, got {text!r}: no permission for {there}")
    return path


def listed(kind: Callable[[str], T]) -> Callable[[str], list[T]]:
    """An argparse type: values of `kind` separated by commas."""

    def parse(text: str) -> list[T]:
        return [kind(part) for part in text.split(",")]

    parse.__name__ = f"list of {getattr(kind, '__name__', 'values')}"
    return parse


def chosen(what: str, text: str, known: list[str]) -> list[str]:
    """Names separated by commas, or all that are known.

    Raises:
        ValueError: one of them is not known.
    """
    names = known if text == "all" else text.split(",")
    if unknown := [name for name in names if name not in known]:
        raise ValueError(f"{what} must be one of {', '.join(known)}, got {', '.join(map(repr, unknown))}")
    return names


count = whole(1, MAX_THREADS)  # a number of threads
seed = whole(0)


def parser(program: str = "bigtri bench") -> argparse.ArgumentParser:
    catalogue = "\n".join(f"  {name:9} {recipe.title}" for name, recipe in scenes.SCENES.items())
    result = argparse.ArgumentParser(
        prog=program,
        description="Times the rasterizer: setup, clear and every triangle into a packed depth-and-id image.",
        epilog=f"scenes:\n{catalogue}\n\nexamples:\n"
        f"  {program} --quick\n"
        f"  {program} --scenes S1,S3 --size 1080p,4k --threads 1,2 --csv out.csv\n"
        f"  {program} --scenes S3 --isa all",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    result.add_argument("--scenes", default=DEFAULT_SCENES, help=f"names separated by commas, or all (default {DEFAULT_SCENES})")
    result.add_argument("--size", type=listed(size), default="1080p", help="WIDTHxHEIGHT, 1080p, 4k, 8k, 16k (default 1080p)")
    result.add_argument("--threads", type=listed(count), help="thread counts (default: torch's)")
    result.add_argument("--isa", help="instruction sets, or all (default: the fastest this CPU has)")
    result.add_argument("--variant", default="auto", help="algorithm variants, or all (default auto)")
    result.add_argument("--seed", type=seed, default=scenes.SEED, help=f"the scenes' seed (default {scenes.SEED})")
    result.add_argument("--seconds", type=seconds, default=1.0, help="time for each case (default 1.0)")
    result.add_argument("--csv", type=csv_file, metavar="FILE", help="also write the rows there")
    result.add_argument("--quick", action="store_true", help="S1, S2, S3 at 960x540, 0.2 s each: does it run?")
    return result


HEADER = (
    f"{'scene':8} {'size':>10} {'threads':>7} {'isa':>8} {'variant':>10} "
    f"{'median ms':>10} {'min':>9} {'p25':>9} {'p75':>9} {'Mfrag/s':>9}"
)


def table_line(row: Row) -> str:
    rate = f"{row.fragments / row.ms_median / 1e3:9.0f}" if row.fragments is not None else f"{'':9}"
    return (
        f"{row.scene:8} {f'{row.width}x{row.height}':>10} {row.threads:7} {row.isa:>8} {row.variant:>10} "
        f"{row.ms_median:10.3f} {row.ms_min:9.3f} {row.ms_p25:9.3f} {row.ms_p75:9.3f} {rate}"
    )


def main(argv: Sequence[str] | None = None) -> int:
    import torch

    from .. import native

    arguments = parser().parse_args(argv)
    if not native.available():
        parser().error(f"the extension is not built: {native.load_error()}")
    if arguments.quick:
        arguments.scenes, arguments.size, arguments.seconds = "S1,S2,S3", [(960, 540)], 0.2
    try:
        names = chosen("scene", arguments.scenes, list(scenes.SCENES))
        isas = chosen("instruction set", arguments.isa or native.isa(), native.isa_levels())
        variants = ["auto"] if arguments.variant == "auto" else chosen("variant", arguments.variant, list(native.VARIANTS["cpu"]))
        # All before anything is measured: one may not fit its image.
        sizes = itertools.product(arguments.size, names)
        cases = [(name, width, height, scenes.make(name, width, height, arguments.seed)) for (width, height), name in sizes]
    except ValueError as error:
        parser().error(str(error))
    settings = list(itertools.product(variants, arguments.threads or [torch.get_num_threads()], isas))

    print(f"{device()}; {versions()}; {commit()}\n{HEADER}", flush=True)
    rows = []
    for name, width, height, scene in cases:
        if sys.stderr.isatty():
            print(f"{name} {width}x{height} ...", end="\r", file=sys.stderr, flush=True)
        fragments = None
        for variant, threads, isa in settings:
            job = Job(name, width, height, scene, variant)
            fragments = job.fragments() if fragments is None else fragments
            rows.append(measure(job, threads, isa, arguments.seconds, fragments))
            print(table_line(rows[-1]), flush=True)
    if arguments.csv:
        write_csv(arguments.csv, rows)
        print(f"{len(rows)} rows in {arguments.csv}")
    return 0
