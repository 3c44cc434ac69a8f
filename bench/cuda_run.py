"""The GPU benchmark: bigtri's CUDA variants on the scenes, beside a memset, the floor and what other rasterizers took.

For each scene, size and seed, and each batch, every variant draws `packed` (depth and triangle, 8 bytes a pixel) into an
image that is there already: clear, set-up and every triangle included. cuda_cases.py says what is drawn, cuda_clock.py how
it is timed. After each measurement the image is poisoned, drawn once more in the same way and compared with the CPU's, bit
for bit; of a batch three views are.

In the same run: `memset`, cudaMemsetAsync of the image; `empty kernel`, what a graph of one costs; and, not of batches, the
floor (floor.cu), two ways to fill the image with the coverage known beforehand. `host` is how long the host needs for a
call with nothing but positions, triangles and size, `host out` for the call that is timed. Ratios to other rasterizers take
their times from results/h200_peers.csv, so they mean something on an H200 only, with the default seed at 1920x1080 and
3840x2160.

    python bench/cuda_run.py --csv build/gpu/cuda.csv
    python bench/cuda_run.py --scenes S3,S5 --size 2500x1406 --seeds 1000,7 --variants auto --kernels
    python bench/cuda_run.py --model duck.glb bunny.ply --methods graph,host --variants auto
    python bench/cuda_run.py --scenes none --batches 64x256x256,4096x64x64 --batch-scenes R4k,R4k+R16k
    python bench/cuda_run.py --dry-run --scenes S1 --size 640x360 --batches none    # the CPU's variants, the host's clock
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

import cuda_cases
import cuda_clock
import cuda_floor
import torch
from cuda_cases import Case, Maker
from cuda_clock import METHODS, Call, Clock, Job, Machine, Row, text_of

from bigtri import native
from bigtri.app import arguments as option_types
from bigtri.study import benchmark, scenes

PEERS = Path(__file__).parent / "results" / "h200_peers.csv"
HOST = "host"  # the method that times the host
YARDSTICKS = ("memset", "empty kernel", *cuda_floor.KINDS)


class Bench:
    """Measures cases and keeps the rows."""

    def __init__(self, clock: Clock, floor: cuda_floor.Floor | None, where: Machine, methods: list[str], seconds: float) -> None:
        self.clock, self.floor, self.where, self.methods, self.seconds = clock, floor, where, methods, seconds
        self.rows: list[Row] = []
        self.failures: list[str] = []

    def case(self, case: Case, variants: list[str]) -> None:
        """Measures a case by every method; prints nothing."""
        if self.floor:
            self.yardsticks(case, self.floor)
        for variant in variants:
            self.measure(case, variant, partial(case.draw, variant), case.wrong_pixels)
        if HOST in self.methods:
            self.host(case)

    def yardsticks(self, case: Case, floor: cuda_floor.Floor) -> None:
        self.measure(case, "memset", lambda: floor.memset(case.packed))
        self.measure(case, "empty kernel", floor.nothing)
        lists = None if case.job.views > 1 else floor.lists(case.given, case.job.width, case.job.height)
        if lists is None:
            return
        for kind in cuda_floor.KINDS:
            self.measure(case, kind, partial(floor.fill, kind, lists, case.packed), case.wrong_triangles)

    def measure(self, case: Case, variant: str, call: Call, wrong: Callable[[Call], int] | None = None) -> None:
        """Times `call` by every method; `wrong` counts the pixels that are wrong in the image that a call draws."""
        for method in self.methods:
            if method in METHODS:
                self.keep(case, variant, method, partial(self.timed, call, method, wrong))

    def timed(self, call: Call, method: str, wrong: Callable[[Call], int] | None) -> tuple[list[float], int | None]:
        us, again = self.clock.measure(call, method, self.seconds)
        return us, wrong(again) if wrong else None

    def enqueued(self, call: Call) -> tuple[list[float], int | None]:
        return self.clock.host(call, self.seconds), None

    def host(self, case: Case) -> None:
        """How long the host takes for the plain call, and for the one that is timed."""
        for method, call in (("host", case.draw_plain), ("host out", partial(case.draw, "auto"))):
            self.keep(case, "auto", method, partial(self.enqueued, call))

    def keep(self, case: Case, variant: str, method: str, measured: Callable[[], tuple[list[float], int | None]]) -> None:
        """A row of what `measured` gives, microseconds and wrong pixels, or a failure."""
        try:
            us, different = measured()
        except RuntimeError as error:
            self.failures.append(f"{case.job} {variant} {method}: {str(error).splitlines()[0]}")
            if torch.cuda.is_available():
                torch.cuda.synchronize()  # raises again if the device is lost: nothing after that would mean anything
            return
        if us:
            self.rows.append(cuda_clock.row_of(case.job, variant, len(case.triangles), method, us, different, self.where))

    def wrong(self) -> int:
        """Pixels that differ in all of bigtri's images."""
        return sum(row.wrong_pixels or 0 for row in self.rows if row.variant not in YARDSTICKS)


# --- tables


class Times:
    """Medians by job, variant and method."""

    def __init__(self, rows: Iterable[Row], peers: dict[tuple[str, str, int, int], float]) -> None:
        self.us = {(row.job, row.variant, row.method): row.us_median for row in rows}
        self.peers = peers

    def get(self, job: Job, variant: str, method: str = "graph") -> float | None:
        """variant: bigtri's, a yardstick, "floor" for the faster of both, or a peer's name."""
        if variant == "floor":
            return min((us for kind in cuda_floor.KINDS if (us := self.us.get((job, kind, method))) is not None), default=None)
        if (us := self.us.get((job, variant, method))) is not None:
            return us
        return self.peers.get((variant, job.scene, job.width, job.height)) if job.seed == scenes.SEED and job.views == 1 else None


def read_peers(path: Path = PEERS) -> dict[tuple[str, str, int, int], float]:
    """Microseconds by (peer, scene, width, height); empty without the file."""
    if not path.exists():
        return {}
    rows = benchmark.read_csv(path)
    return {(row["peer"], row["scene"], int(row["width"]), int(row["height"])): float(row["us"]) for row in rows}


def ratio(above: float | None, below: float | None) -> str:
    """`above / below` to three figures, "-" if one is missing."""
    return text_of(above / below) if above is not None and below else "-"


HEADER = (
    f"{'scene':14} {'size':>11} {'seed':>5} {'variant':14} {'graph us':>9} {'(p25 to p75)':>15} {'graph20':>8} {'eager':>8} "
    f"{'cold':>8} {'/memset':>8} {'/floor':>7} {'CuRast/':>8} {'nvdiffr/':>8} {'wrong px':>8}"
)


def case_lines(rows: list[Row], times: Times) -> list[str]:
    """A line for each variant of one case, and one for the host; rows: only that case's."""
    lines = []
    on_gpu = [row for row in rows if row.method in METHODS]
    for variant in dict.fromkeys(row.variant for row in on_gpu):
        mine = [row for row in on_gpu if row.variant == variant]
        job = mine[0].job
        quartiles = next((f"{text_of(r.us_p25)} to {text_of(r.us_p75)}" for r in mine if r.method == "graph"), "")
        us = [text_of(times.get(job, variant, method)) for method in METHODS]
        graph = times.get(job, variant)
        line = f"{job.scene:14} {job.size:>11} {job.seed:5} {variant:14} {us[0]:>9} {quartiles:>15} "
        line += f"{us[1]:>8} {us[2]:>8} {us[3]:>8} "
        line += f"{ratio(graph, times.get(job, 'memset')):>8} {ratio(graph, times.get(job, 'floor')):>7} "
        if variant in YARDSTICKS:
            line += f"{'':8} {'':8} "
        else:
            line += f"{ratio(times.get(job, 'CuRast'), graph):>8} {ratio(times.get(job, 'nvdiffrast'), graph):>8} "
        wrong = [row.wrong_pixels for row in mine if row.wrong_pixels is not None]
        line += f"{max(wrong) if wrong else '':>8}"
        if job.views > 1 and graph and variant not in YARDSTICKS:
            line += f"  {job.views / graph * 1e6:,.0f} images/s"
        lines.append(line)
    host = [f"{row.method} {text_of(row.us_min)} ({text_of(row.us_median)})" for row in rows if row.method not in METHODS]
    if host:
        lines.append(f"{rows[0].scene:14} {rows[0].job.size:>11} us of the host, best (median): {', '.join(host)}")
    return lines


def summary_lines(rows: list[Row], times: Times) -> list[str]:
    """For each size and seed the graph times, variants and peers across, scenes down."""
    lines = []
    peers = list(dict.fromkeys(name for name, *_ in times.peers))
    for size in dict.fromkeys(row.job._replace(scene="") for row in rows):
        here = [row for row in rows if row.job._replace(scene="") == size]
        names = list(dict.fromkeys(row.scene for row in here))
        shown = [*dict.fromkeys(row.variant for row in here), *peers]
        us = {variant: [times.get(size._replace(scene=name), variant) for name in names] for variant in shown}
        shown = [variant for variant in shown if any(value is not None for value in us[variant])]
        lines += ["", f"{size.size}, seed {size.seed}, graph replay, us".ljust(40) + "".join(f"{name:>14}" for name in shown)]
        for number, name in enumerate(names):
            lines.append(f"{name:40}" + "".join(f"{text_of(us[variant][number]):>14}" for variant in shown))
    return lines


# --- the command


def kernel_pass(jobs: Iterable[Job], maker: Maker, variants: list[str], device: torch.device, path: Path | None) -> None:
    """Every kernel's time in every case. Last: once the profiler has been on, launching takes longer."""
    lines = [",".join((*Job._fields, "variant", "kernel", "us"))]
    for job in jobs:
        case = Case(job, maker.make(job), device)
        for variant in variants:
            spent = cuda_clock.kernels(partial(case.draw, variant))
            print(f"{job.scene:14} {job.size:>11} {variant:14} {text_of(sum(spent.values())):>9} us in kernels: ", end="")
            print("; ".join(f"{kernel} {text_of(us)}" for kernel, us in spent.items()), flush=True)
            lines += [",".join(map(str, job)) + f',{variant},"{kernel}",{us:.3f}' for kernel, us in spent.items()]
        del case
    if path:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("\n".join(lines) + "\n")
        print(f"{len(lines) - 1} kernels in {path}")


def parser() -> argparse.ArgumentParser:
    result = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    cuda_cases.add_cases(result)
    result.add_argument("--variants", default="all", help="bigtri's, separated by commas (default all, and auto)")
    result.add_argument("--methods", default="all", help=f"of {', '.join((*METHODS, HOST))} (default all)")
    result.add_argument(
        "--seconds", type=option_types.seconds, default=0.1, help="time for each figure, beyond 50 repeats (default 0.1)"
    )
    result.add_argument("--total", type=option_types.seconds, default=240, help="s for all, without --kernels (default 240)")
    result.add_argument("--no-floor", action="store_true", help="neither floor nor memset; needs no nvcc")
    result.add_argument("--kernels", action="store_true", help="then each kernel's time, through torch's profiler")
    result.add_argument(
        "--csv", metavar="FILE", type=option_types.csv_file, help="write the rows there; kernels beside it, FILE_kernels.csv"
    )
    result.add_argument("--dry-run", action="store_true", help="on the CPU by the host's clock: does it run?")
    return result


def main(argv: list[str] | None = None) -> int:
    arguments = parser().parse_args(argv)
    end = time.perf_counter() + arguments.total
    device = cuda_cases.device_for(arguments.dry_run)
    variants = cuda_clock.listed(arguments.variants, "variant", [*native.VARIANTS[device.type], "auto"])
    methods = cuda_clock.listed(arguments.methods, "method", (*METHODS, HOST))
    maker = cuda_cases.maker_for(arguments)
    jobs = cuda_cases.jobs(arguments, maker)
    where = cuda_clock.machine()
    print(cuda_clock.headline(where))
    floor = None if arguments.no_floor else cuda_cases.start_floor(device)
    bench = Bench(cuda_clock.clock_for(device), floor, where, methods, arguments.seconds)
    peers = read_peers()

    print(HEADER, flush=True)
    for job, given in cuda_cases.made(jobs, maker, end):
        before = len(bench.rows)
        try:
            bench.case(Case(job, given, device), variants)
        except RuntimeError as error:  # the device is lost, and with it what is still to come
            bench.failures.append(f"{job}: {str(error).splitlines()[0]}; nothing after it was measured")
            arguments.kernels = False
            break
        print("\n".join(case_lines(bench.rows[before:], Times(bench.rows[before:], peers))), flush=True)
        if arguments.csv:
            # after each case: an interrupted run keeps what it has
            benchmark.write_csv(arguments.csv, bench.rows, cuda_clock.DIGITS)
        if device.type == "cuda":
            torch.cuda.empty_cache()
    if arguments.kernels and device.type == "cuda":
        beside = arguments.csv and arguments.csv.with_name(f"{arguments.csv.stem}_kernels.csv")
        kernel_pass(dict.fromkeys(row.job for row in bench.rows), maker, variants, device, beside)
    print("\n".join(summary_lines(bench.rows, Times(bench.rows, peers))))
    for failure in bench.failures:
        print("FAILED", failure)
    spread = [(row.us_p75 - row.us_p25) / row.us_median for row in bench.rows if row.method == "graph" and row.us_median]
    print(f"{len(bench.rows)} rows; {bench.wrong()} wrong pixels in bigtri's images; {len(bench.failures)} failures", end="")
    print(f"; quartiles lie {statistics.median(spread):.1%} of the median apart" if spread else "")
    return 1 if bench.wrong() or bench.failures or not bench.rows else 0


if __name__ == "__main__":
    sys.exit(main())
