"""``bigtri bench``: times the rasterizer on the benchmark's scenes."""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from ..precision import DEFAULT, PRECISIONS
from ..study import scenes
from . import arguments

if TYPE_CHECKING:
    from ..study.benchmark import Row


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
    result.add_argument("--scenes", default=scenes.DEFAULT, help=f"names separated by commas, or all (default {scenes.DEFAULT})")
    result.add_argument(
        "--size", type=arguments.listed(arguments.size), default="1080p", help="WIDTHxHEIGHT, 1080p, 4k, 8k, 16k (default 1080p)"
    )
    result.add_argument("--threads", type=arguments.listed(arguments.count), help="thread counts (default: torch's)")
    result.add_argument("--isa", help="instruction sets, or all (default: the fastest this CPU has)")
    result.add_argument("--variant", default="auto", help="algorithm variants, or all (default auto)")
    result.add_argument("--precision", default=DEFAULT, help=f"rungs, or all (default {DEFAULT})")
    result.add_argument("--seed", type=arguments.seed, default=scenes.SEED, help=f"the scenes' seed (default {scenes.SEED})")
    result.add_argument("--seconds", type=arguments.seconds, default=1.0, help="time for each case (default 1.0)")
    result.add_argument("--csv", type=arguments.csv_file, metavar="FILE", help="also write the rows there")
    result.add_argument("--quick", action="store_true", help="S1, S2, S3 at 960x540, 0.2 s each: does it run?")
    return result


HEADER = (
    f"{'scene':8} {'size':>10} {'threads':>7} {'isa':>8} {'variant':>10} {'precision':>25} "
    f"{'median ms':>10} {'min':>9} {'p25':>9} {'p75':>9} {'Mfrag/s':>9}"
)


def table_line(row: Row) -> str:
    rate = f"{row.fragments / row.ms_median / 1e3:9.0f}" if row.fragments is not None else f"{'':9}"
    return (
        f"{row.scene:8} {f'{row.width}x{row.height}':>10} {row.threads:7} {row.isa:>8} {row.variant:>10} {row.precision:>25} "
        f"{row.ms_median:10.3f} {row.ms_min:9.3f} {row.ms_p25:9.3f} {row.ms_p75:9.3f} {rate}"
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``bigtri bench``; returns the exit code.

    Raises:
        SystemExit: argparse's, for --help and for what cannot be measured: an unknown name, an image too small for its scene.
    """
    command = parser()
    options = command.parse_args(argv)
    if options.quick:
        options.scenes, options.size, options.seconds = "S1,S2,S3", [(960, 540)], 0.2
    try:
        names = arguments.chosen("scene", options.scenes, list(scenes.SCENES))
        precisions = arguments.chosen("precision", options.precision, list(PRECISIONS))
    except ValueError as error:
        command.error(str(error))

    import torch  # only now: what is wrong with the command line is said at once

    from .. import native
    from ..study import benchmark, provenance

    if not native.available():
        command.error(f"the extension is not built: {native.load_error()}")
    try:
        isas = arguments.chosen("instruction set", options.isa or native.isa(), native.isa_levels())
        known = list(native.VARIANTS["cpu"])
        variants = ["auto"] if options.variant == "auto" else arguments.chosen("variant", options.variant, known)
        # All before anything is measured: one may not fit its image.
        sizes = itertools.product(options.size, names)
        cases = [(name, width, height, scenes.make(name, width, height, options.seed)) for (width, height), name in sizes]
    except ValueError as error:
        command.error(str(error))
    rungs = native.REGISTRY["cpu"]
    if missing := [precision for precision in precisions if precision not in rungs]:
        if options.precision != "all":
            command.error(
                f"precision must be one of {', '.join(rungs)}, as the extension is built here, got {', '.join(missing)}"
            )
        precisions = list(rungs)
    every = itertools.product(precisions, variants, options.threads or [torch.get_num_threads()], isas)
    settings = [one for one in every if one[1] == "auto" or one[1] in rungs[one[0]]]

    print(f"{provenance.device()}; {provenance.versions()}; {provenance.commit()}\n{HEADER}", flush=True)
    rows = []
    for name, width, height, scene in cases:
        if sys.stderr.isatty():
            print(f"{name} {width}x{height} ...", end="\r", file=sys.stderr, flush=True)
        fragments: dict[str, int] = {}
        for precision, variant, threads, isa in settings:
            job = benchmark.Job(name, width, height, scene, variant, precision)
            if precision not in fragments:
                fragments[precision] = job.fragments()
            rows.append(benchmark.measure(job, threads, isa, options.seconds, fragments[precision]))
            print(table_line(rows[-1]), flush=True)
    if options.csv:
        benchmark.write_csv(options.csv, rows)
        print(f"{len(rows)} rows in {options.csv}")
    return 0
