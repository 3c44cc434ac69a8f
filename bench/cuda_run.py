"""The GPU benchmark: bigtri's CUDA variants on the scenes, beside a memset, the floor and what other rasterizers took.

For each scene, size and seed every variant draws `packed` (depth and triangle, 8 bytes a pixel) into an image that is there
already: clear, set-up and every triangle included. cuda_clock.py says how it is timed. After each measurement the image is
poisoned, drawn once more in the same way and compared with the CPU's, bit for bit.

In the same run: `memset`, cudaMemsetAsync of the image; `empty kernel`, what a graph of one costs; and the floor (floor.cu), two
ways to fill the image with the coverage known beforehand. Ratios to other rasterizers take their times from
results/h200_peers.csv, so they mean something on an H200 only, with the default seed at 1920x1080 and 3840x2160.

    python bench/cuda_run.py --csv build/gpu/cuda.csv
    python bench/cuda_run.py --scenes S3,S5 --size 2500x1406 --seeds 1000,7 --variants auto --kernels
    python bench/cuda_run.py --dry-run --scenes S1 --size 640x360    # without a GPU: the CPU's variants and the host's clock
"""

from __future__ import annotations

import argparse
import statistics
import sys
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

import cuda_clock
import cuda_floor
import torch
from cuda_clock import METHODS, Call, Clock, Machine, Row, text_of

import bigtri
from bigtri import native
from bigtri.app import arguments as option_types
from bigtri.study import benchmark, scenes
from bigtri.study.clock import summary

SCENES = "S1,S2,S3,S4f,S4b,S5,S6,S7"
PEERS = Path(__file__).parent / "results" / "h200_peers.csv"
YARDSTICKS = ("memset", "empty kernel", *cuda_floor.KINDS)


class Target:
    """A scene's tensors on a device, and the image that it is drawn into."""

    def __init__(self, scene: scenes.Triangles, size: tuple[int, int], device: torch.device) -> None:
        self.scene, self.size = scene, size  # height, width
        self.positions = torch.from_numpy(scene.positions).to(device)
        self.triangles = torch.from_numpy(scene.triangles).to(device)
        self.packed = torch.empty(size, dtype=torch.int64, device=device)

    def from_cpu(self) -> torch.Tensor:
        """The image as the CPU draws it, on the device."""
        on_cpu = torch.from_numpy(self.scene.positions), torch.from_numpy(self.scene.triangles)
        return torch.as_tensor(bigtri.rasterize(*on_cpu, self.size, backend="native", depth=False).packed).to(self.packed.device)

    def draw(self, variant: str) -> None:
        bigtri.rasterize(self.positions, self.triangles, self.size, depth=False, out=self.packed, variant=variant)

    def poisoned(self, draw: Call) -> torch.Tensor:
        """The image after `draw`, which has nothing of an earlier one's to show."""
        self.packed.fill_(cuda_clock.POISON)
        draw()
        return self.packed


def differing(a: torch.Tensor, b: torch.Tensor) -> int:
    """Pixels that differ; in strips, since the comparison needs memory too."""
    return sum(int((x != y).sum()) for x, y in zip(a.split(4096), b.split(4096), strict=True))


class Case(Target):
    """A scene of one size, and what its image has to be."""

    def __init__(self, name: str, width: int, height: int, seed: int, scene: scenes.Triangles, device: torch.device) -> None:
        super().__init__(scene, (height, width), device)
        self.name, self.width, self.height, self.seed = name, width, height, seed
        self.expected = self.from_cpu()

    def wrong_pixels(self, draw: Call) -> int:
        """Pixels of the image that `draw` makes whose bits are not the CPU's."""
        return differing(self.poisoned(draw), self.expected)

    def wrong_triangles(self, draw: Call) -> int:
        """Pixels that show another triangle than the CPU's: a floor has its depth in float32."""
        return int(((self.poisoned(draw) ^ self.expected) & 0xFFFFFFFF != 0).sum())


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

    def yardsticks(self, case: Case, floor: cuda_floor.Floor) -> None:
        self.measure(case, "memset", lambda: floor.memset(case.packed))
        self.measure(case, "empty kernel", floor.nothing)
        lists = floor.lists(case.scene, case.width, case.height)
        if lists is None:
            return
        for kind in cuda_floor.KINDS:
            self.measure(case, kind, partial(floor.fill, kind, lists, case.packed), case.wrong_triangles)

    def measure(self, case: Case, variant: str, call: Call, wrong: Callable[[Call], int] | None = None) -> None:
        """Times `call` by every method; `wrong` counts the pixels that are wrong in the image that a call draws."""
        for method in self.methods:
            try:
                us, again = self.clock.measure(call, method, self.seconds)
                different = wrong(again) if wrong else None
            except RuntimeError as error:
                self.failures.append(f"{case.name} {case.width}x{case.height} {variant} {method}: {str(error).splitlines()[0]}")
                if torch.cuda.is_available():
                    torch.cuda.synchronize()  # raises again if the device is lost: nothing after that would mean anything
                continue
            if not us:
                continue
            timing = summary(us)
            self.rows.append(
                Row(
                    scene=case.name,
                    width=case.width,
                    height=case.height,
                    seed=case.seed,
                    variant=variant,
                    triangles=len(case.triangles),
                    method=method,
                    us_median=timing.median,
                    us_min=timing.minimum,
                    us_p25=timing.p25,
                    us_p75=timing.p75,
                    repeats=timing.repeats,
                    wrong_pixels=different,
                    **self.where._asdict(),
                )
            )

    def wrong(self) -> int:
        """Pixels that differ in all of bigtri's images."""
        return sum(row.wrong_pixels or 0 for row in self.rows if row.variant not in YARDSTICKS)


# --- tables

Key = tuple[str, int, int, int]  # scene, width, height, seed


def key_of(row: Row) -> Key:
    return row.scene, row.width, row.height, row.seed


class Times:
    """Medians by case, variant and method."""

    def __init__(self, rows: Iterable[Row], peers: dict[tuple[str, str, int, int], float]) -> None:
        self.us = {(key_of(row), row.variant, row.method): row.us_median for row in rows}
        self.peers = peers

    def get(self, key: Key, variant: str, method: str = "graph") -> float | None:
        """variant: bigtri's, a yardstick, "floor" for the faster of both, or a peer's name."""
        if variant == "floor":
            return min((us for kind in cuda_floor.KINDS if (us := self.us.get((key, kind, method))) is not None), default=None)
        if (us := self.us.get((key, variant, method))) is not None:
            return us
        scene, width, height, seed = key
        return self.peers.get((variant, scene, width, height)) if seed == scenes.SEED else None


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
    f"{'scene':8} {'size':>10} {'seed':>5} {'variant':14} {'graph us':>9} {'(p25 to p75)':>15} {'graph20':>8} {'eager':>8} "
    f"{'cold':>8} {'/memset':>8} {'/floor':>7} {'CuRast/':>8} {'nvdiffr/':>8} {'wrong px':>8}"
)


def case_lines(rows: list[Row], times: Times) -> list[str]:
    """A line for each variant of one case; rows: only that case's."""
    lines = []
    for variant in dict.fromkeys(row.variant for row in rows):
        mine = [row for row in rows if row.variant == variant]
        key, first = key_of(mine[0]), mine[0]
        quartiles = next((f"{text_of(r.us_p25)} to {text_of(r.us_p75)}" for r in mine if r.method == "graph"), "")
        us = [text_of(times.get(key, variant, method)) for method in METHODS]
        graph = times.get(key, variant)
        line = f"{first.scene:8} {f'{first.width}x{first.height}':>10} {first.seed:5} {variant:14} {us[0]:>9} {quartiles:>15} "
        line += f"{us[1]:>8} {us[2]:>8} {us[3]:>8} "
        line += f"{ratio(graph, times.get(key, 'memset')):>8} {ratio(graph, times.get(key, 'floor')):>7} "
        if variant in YARDSTICKS:
            line += f"{'':8} {'':8} "
        else:
            line += f"{ratio(times.get(key, 'CuRast'), graph):>8} {ratio(times.get(key, 'nvdiffrast'), graph):>8} "
        wrong = [row.wrong_pixels for row in mine if row.wrong_pixels is not None]
        lines.append(line + f"{max(wrong) if wrong else '':>8}")
    return lines


def summary_lines(rows: list[Row], times: Times) -> list[str]:
    """For each size and seed the graph times, scenes across, variants and peers down."""
    lines = []
    peers = list(dict.fromkeys(name for name, *_ in times.peers))
    for width, height, seed in dict.fromkeys((row.width, row.height, row.seed) for row in rows):
        here = [row for row in rows if (row.width, row.height, row.seed) == (width, height, seed)]
        names = list(dict.fromkeys(row.scene for row in here))
        lines += ["", f"{width}x{height}, seed {seed}, graph replay, us" + "".join(f"{name:>9}" for name in names)]
        for variant in [*dict.fromkeys(row.variant for row in here), *peers]:
            us = [times.get((name, width, height, seed), variant) for name in names]
            if any(value is not None for value in us):
                lines.append(f"{variant:34}" + "".join(f"{text_of(value):>9}" for value in us))
    return lines


# --- the command


def device_for(dry: bool) -> torch.device:
    """The GPU, or the CPU for a dry run.

    Raises:
        SystemExit: the extension or the GPU is missing.
    """
    if not native.available():
        raise SystemExit(f"the extension is not built: {native.load_error()}")
    if dry:
        return torch.device("cpu")
    if "cuda" not in native.devices():
        raise SystemExit("no GPU, or the extension is not built for CUDA; --dry-run does without")
    return torch.device("cuda", torch.cuda.current_device())


def start_floor(device: torch.device) -> cuda_floor.Floor | None:
    """floor.cu, or None (and why, on the screen)."""
    try:
        return cuda_floor.Floor(device)
    except cuda_floor.UnavailableError as error:
        print(f"no memset, empty kernel or floor: {error}")
        return None


def kernel_pass(cases: list[tuple[str, int, int, int]], variants: list[str], device: torch.device, path: Path | None) -> None:
    """Every kernel's time in every case. Last: once the profiler has been on, launching takes longer."""
    lines = ["scene,width,height,seed,variant,kernel,us"]
    for name, width, height, seed in cases:
        case = Case(name, width, height, seed, scenes.make(name, width, height, seed), device)
        for variant in variants:
            spent = cuda_clock.kernels(partial(case.draw, variant))
            print(f"{name:8} {f'{width}x{height}':>10} {variant:14} {text_of(sum(spent.values())):>9} us in kernels: ", end="")
            print("; ".join(f"{kernel} {text_of(us)}" for kernel, us in spent.items()), flush=True)
            lines += [f'{name},{width},{height},{seed},{variant},"{kernel}",{us:.3f}' for kernel, us in spent.items()]
        del case
    if path:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("\n".join(lines) + "\n")
        print(f"{len(lines) - 1} kernels in {path}")


def parser() -> argparse.ArgumentParser:
    result = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    result.add_argument("--scenes", default=SCENES, help=f"default {SCENES}")
    result.add_argument("--size", type=option_types.listed(option_types.size), default="1080p,4k", help="default 1080p,4k")
    result.add_argument(
        "--seeds", type=option_types.listed(option_types.seed), default=str(scenes.SEED), help=f"default {scenes.SEED}"
    )
    result.add_argument("--variants", default="all", help="bigtri's, separated by commas (default all, and auto)")
    result.add_argument("--methods", default="all", help=f"of {', '.join(METHODS)} (default all)")
    result.add_argument(
        "--seconds", type=option_types.seconds, default=0.1, help="time for each figure, beyond 50 repeats (default 0.1)"
    )
    result.add_argument("--no-floor", action="store_true", help="neither floor nor memset; needs no nvcc")
    result.add_argument("--kernels", action="store_true", help="then each kernel's time, through torch's profiler")
    result.add_argument(
        "--csv", metavar="FILE", type=option_types.csv_file, help="write the rows there; kernels beside it, FILE_kernels.csv"
    )
    result.add_argument("--dry-run", action="store_true", help="on the CPU by the host's clock: does it run?")
    return result


def main(argv: list[str] | None = None) -> int:
    arguments = parser().parse_args(argv)
    device = device_for(arguments.dry_run)
    variants = cuda_clock.listed(arguments.variants, "variant", [*native.VARIANTS[device.type], "auto"])
    names = cuda_clock.listed(arguments.scenes, "scene", scenes.SCENES)
    methods = cuda_clock.listed(arguments.methods, "method", METHODS)
    where = cuda_clock.machine()
    print(cuda_clock.headline(where))
    floor = None if arguments.no_floor else start_floor(device)
    clock: Clock = cuda_clock.WallClock()
    if device.type == "cuda":
        cuda_clock.warm_up()
        clock = cuda_clock.CudaClock()
    bench = Bench(clock, floor, where, methods, arguments.seconds)
    peers = read_peers()

    print(HEADER, flush=True)
    cases = [(name, width, height, seed) for seed in arguments.seeds for width, height in arguments.size for name in names]
    for name, width, height, seed in cases:
        try:
            scene = scenes.make(name, width, height, seed)
        except ValueError as error:  # the image is too small for it
            print(error)
            continue
        before = len(bench.rows)
        try:
            bench.case(Case(name, width, height, seed, scene, device), variants)
        except RuntimeError as error:  # the device is lost, and with it what is still to come
            bench.failures.append(f"{name} {width}x{height}: {str(error).splitlines()[0]}; nothing after it was measured")
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
        kernel_pass([key for key in dict.fromkeys(map(key_of, bench.rows))], variants, device, beside)
    print("\n".join(summary_lines(bench.rows, Times(bench.rows, peers))))
    for failure in bench.failures:
        print("FAILED", failure)
    spread = [(row.us_p75 - row.us_p25) / row.us_median for row in bench.rows if row.method == "graph" and row.us_median]
    print(f"{len(bench.rows)} rows; {bench.wrong()} wrong pixels in bigtri's images; {len(bench.failures)} failures", end="")
    print(f"; quartiles lie {statistics.median(spread):.1%} of the median apart" if spread else "")
    return 1 if bench.wrong() or bench.failures or not bench.rows else 0


if __name__ == "__main__":
    sys.exit(main())
