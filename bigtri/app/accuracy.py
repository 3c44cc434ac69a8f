"""``bigtri accuracy``: what each rung of the precision ladder gets wrong, and the time that it takes."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ..precision import DEFAULT, PRECISIONS, PRESETS
from ..study import scenes
from . import arguments

if TYPE_CHECKING:
    from ..study.accuracy import Case, Row

_QUICK = ("ties", "needles", "fight", "floor", "R4k", "S2")
_QUICK_RUNGS = (
    "exact,balanced,fast,subpixel4,coverage_float32_fused,coverage_float32_inclusive,depth_float32_cell,depth_float32_vertex,"
    "depth_stored16,mask_none,clip_none,attributes_float32,attributes_affine"
)


def parser(program: str = "bigtri accuracy") -> argparse.ArgumentParser:
    result = argparse.ArgumentParser(
        prog=program,
        description="Holds every rung of the precision ladder against the exact truth, and times it beside exact.",
        epilog=f"examples:\n"
        f"  {program} --quick\n"
        f"  {program} --csv accuracy.csv --plots plots\n"
        f"  {program} --scenes ties,R16k,Rcourtyard --size 1080p,4k --precision subpixel4,coverage_float32\n"
        f"  {program} --variant bin_owned --precision {','.join(PRESETS)}\n"
        f"  {program} --model scan.ply --scenes ties\n"
        f"  {program} --breaks pictures",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    result.add_argument("--scenes", help="names separated by commas: hard cases, or those of bigtri bench (default: a choice)")
    result.add_argument("--model", type=Path, action="append", default=[], metavar="FILE", help="a model to draw as well")
    result.add_argument(
        "--size", type=arguments.listed(arguments.size), default="1280x720", help="of scenes and models (default %(default)s)"
    )
    result.add_argument(
        "--precision",
        help=f"rungs separated by commas, presets ({', '.join(PRESETS)}) among them, or all (default: all that are compiled)",
    )
    result.add_argument("--device", choices=("cpu", "cuda"), default="cpu", help="where to draw (default %(default)s)")
    result.add_argument("--variant", default="two_stage", help="the schedule of all rungs (default %(default)s, which all have)")
    result.add_argument("--threads", type=arguments.count, default=1, help="of the CPU (default %(default)s)")
    result.add_argument("--isa", default="", help="instruction set of the CPU (default: the fastest)")
    result.add_argument("--seed", type=arguments.seed, default=scenes.SEED, help="of scenes and samples (default %(default)s)")
    result.add_argument("--seconds", type=arguments.seconds, help="time of the clock for each case (default 12)")
    result.add_argument("--csv", type=arguments.csv_file, metavar="FILE", help="also write the rows there")
    result.add_argument("--plots", type=Path, metavar="FOLDER", help="also draw plots there; needs matplotlib")
    result.add_argument("--breaks", type=Path, metavar="FOLDER", help="draw where each rung breaks, beside exact; no table")
    result.add_argument(
        "--times", action="store_true", help="times alone: the errors are those of any other device, as the bits are the same"
    )
    result.add_argument(
        "--errors", type=Path, metavar="CSV", help="as --times, and the errors are those that another run wrote there"
    )
    result.add_argument("--quick", action="store_true", help="few scenes, rungs and samples: half a minute on 2 cores")
    return result


HEADER = (
    f"{'precision':26} {'ms':>8} {'x exact':>8} {'quartiles':>13} {'wrong ppm':>10} {'flips':>8} {'cracks':>7} {'overlaps':>8} "
    f"{'ulp 50 %':>9} {'99 %':>8} {'max':>8} {'texels 99 %':>11} {'max':>9} {'PSNR':>6} {'SSIM':>6}"
)


def table_line(row: Row) -> str:
    def shown(value: float | None, width: int, digits: int = 3) -> str:
        return f"{'' if value is None else f'{value:.{digits}g}':>{width}}"

    spread = f"{row.ratio_p25:.3f}-{row.ratio_p75:.3f}"
    return (
        f"{row.precision:26} {row.ms_median:8.4f} {row.ratio:8.3f} {spread:>13} {shown(row.wrong_ppm, 10, 4)} "
        f"{shown(row.flips_ppm, 8)} {shown(row.cracks_ppm, 7)} {shown(row.overlaps_ppm, 8)} {shown(row.depth_ulp_median, 9, 2)} "
        f"{shown(row.depth_ulp_p99, 8, 2)} {shown(row.depth_ulp_max, 8, 2)} {shown(row.texels_p99, 11, 2)} "
        f"{shown(row.texels_max, 9, 2)} {shown(row.psnr, 6)} {shown(row.ssim, 6)}"
    )


def _compared(row: Row) -> str:
    if row.sample_px is None:
        return "times alone"
    return f"{row.sample_px} px compared, depth and weights at {row.depth_px}"


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``bigtri accuracy``; returns the exit code.

    Raises:
        SystemExit: argparse's, for --help and for what cannot be measured: an unknown name, a rung that is not compiled.
        ImportError: --plots without matplotlib.
    """
    command = parser()
    options = command.parse_args(argv)
    try:
        wanted = arguments.chosen("precision", options.precision or "all", list(PRECISIONS))
    except ValueError as error:
        command.error(str(error))

    from .. import native  # only now: what is wrong with the command line is said at once
    from ..study import accuracy, benchmark, provenance

    if options.breaks:
        from ..study import breaks

        for path in breaks.draw_all(options.breaks):
            print(path)
        return 0
    if options.plots:
        from ..study import accuracy_plots  # without matplotlib it is said before anything is measured
    if not native.available():
        command.error(f"the extension is not built: {native.load_error()}")
    if options.device not in native.REGISTRY:
        command.error(
            f"--device must be one of {', '.join(native.REGISTRY)}, as the extension is built here, got {options.device}"
        )
    if options.isa:
        try:
            arguments.chosen("instruction set", options.isa, native.isa_levels())
        except ValueError as error:
            command.error(str(error))
    setting = accuracy.Setting(options.device, options.variant, options.threads, options.isa)
    rungs = _rungs(command, options, wanted, setting.rungs())
    effort = accuracy.QUICK if options.quick else accuracy.FULL
    if options.seconds is not None:
        effort = effort._replace(seconds=options.seconds)
    cases = _cases(command, options)
    earlier = _earlier(command, options.errors)

    print(f"{provenance.device(options.device)}; {provenance.versions()}; {provenance.commit()}", flush=True)
    rows: list[Row] = []
    for case in cases:
        if sys.stderr.isatty():
            print(f"{case.name} {case.width}x{case.height} ...", end="\r", file=sys.stderr, flush=True)
        found = accuracy.study(case, rungs, setting, effort, options.seed, with_errors=not (options.times or options.errors))
        if without := accuracy.fill_errors(found, earlier) if options.errors else 0:
            print(
                f"\n{options.errors} has no errors of {without} rows of {case.name}, {case.width}x{case.height} px",
                file=sys.stderr,
            )
        rows += found
        first = found[0]
        print(
            f"\n{case.name}, {first.triangles} triangles, {case.width}x{case.height} px, {first.variant}, "
            f"{first.threads} threads, {first.isa or options.device}; {_compared(first)}\n{HEADER}"
        )
        for row in found:
            print(table_line(row), flush=True)
        if options.csv:  # after every case, so that nothing is lost when a long run is stopped
            benchmark.write_csv(options.csv, rows)
    if options.csv:
        print(f"{len(rows)} rows in {options.csv}")
    if options.plots:
        for path in accuracy_plots.draw_all(rows, options.plots):
            print(path)
    return 0


def _earlier(command: argparse.ArgumentParser, path: Path | None) -> list[dict[str, str]]:
    """The rows of --errors."""
    from ..study import accuracy, benchmark

    if path is None:
        return []
    try:
        rows = benchmark.read_csv(path)
    except OSError as error:
        command.error(f"--errors: {error}")
    if not rows or not {"scene", "triangles", "width", "height", "precision", *accuracy.ERRORS} <= set(rows[0]):
        command.error(f"--errors must be a CSV that bigtri accuracy wrote, got {path}")
    return rows


def _rungs(command: argparse.ArgumentParser, options: argparse.Namespace, wanted: list[str], there: list[str]) -> list[str]:
    """Those to be measured; all that are compiled where none is named."""
    if DEFAULT not in there:
        command.error(f"--variant must be one that {DEFAULT!r} has on {options.device}, got {options.variant!r}")
    if options.precision in (None, "all"):
        names = _QUICK_RUNGS.split(",") if options.quick and options.precision is None else wanted
        if missing := [rung for rung in names if rung not in there]:
            how = "BIGTRI_LADDER=1 builds them, see docs/accuracy.md"
            print(f"not measured, as the extension is built here: {', '.join(missing)}; {how}", file=sys.stderr)
        return [rung for rung in names if rung in there]
    if missing := [rung for rung in wanted if rung not in there]:
        command.error(f"precision must be one of {', '.join(there)}, as the extension is built here, got {', '.join(missing)}")
    return wanted


def _cases(command: argparse.ArgumentParser, options: argparse.Namespace) -> list[Case]:
    """All before anything is measured: one may not fit its image."""
    from ..study import accuracy

    default = ",".join(_QUICK if options.quick else accuracy.DEFAULT_NAMES)
    sizes = [(640, 360)] if options.quick and options.size == command.get_default("size") else options.size
    try:
        names = arguments.chosen("scene", options.scenes or default, [*accuracy.HARD, *scenes.SCENES])
        cases = [accuracy.case(name, 0, 0) for name in names if name in accuracy.HARD]
        for width, height in sizes:
            cases += [accuracy.case(name, width, height, options.seed) for name in names if name not in accuracy.HARD]
            cases += [accuracy.of_model(path, width, height) for path in options.model]
    except ValueError as error:
        command.error(str(error))
    return cases
