"""Every variant on every scene at every size: time, work, and what a unit of work costs. Makes the tables of docs/variants.md.

Variants and their parameters are those of the registry. In each case (scene and size) they take turns, in every round in an
order of its own; what takes longer than `SLOW` draws twice, and its time is that of the second frame. All images are
compared in bits. The build that counts says how much work each does (docs/variants.md); on CUDA, if it was built for that.

The parts of the report:
* scenes: every variant on every scene at every size, with its memory and counters;
* parameters: block sizes, tile sizes, levels, room of queues and all else that a variant has as a parameter, one at a time;
* distance: meshes from near to far;
* motion: frames that follow another camera's, and frames that follow their like;
* stages: the same for each stage: on the CPU of the stages one by one, on CUDA of each variant's kernels.

From times and counters follows what each variant pays for a unit of work: the non-negative costs, the same in all cases, that
come nearest to its times in proportion. The fit is tried on each scene with the costs of all other scenes. `--predict`
says with them which variant wins on a scene that is not in the report, and measures it only then.

    python bench/variants.py --csv bench/results/variants_cpu.csv --docs docs/variants.md
    python bench/variants.py --rows bench/results/variants_cpu.csv --docs docs/variants.md      # tables alone
    python bench/variants.py --rows bench/results/variants_cpu.csv --predict Rroom --size 1080p --csv build/with_it.csv
    python bench/variants.py --parts distance,motion --csv build/some.csv
    python bench/variants.py --device cuda --seconds 0.02 --csv build/gpu/variants.csv
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import cuda_clock
import markdown
import torch
import variant_tables
from variant_cases import SLOW, Case, Moving, sweep
from variant_costs import fit
from variant_rows import PARTS, PREDICTION, Key, Row, by_variant, read, text_of, write

from bigtri import native
from bigtri.app import arguments as option_types
from bigtri.precision import DEFAULT
from bigtri.study import clock, provenance, scenes, tune

# Rroom and R16k are left for predictions, in all parts.
SCENES = "R4k,R16k-close,R16k-far,R100k,R100k-shuffled,R1M,Rcourtyard,Rterrain,S1,S2,S3,S4f,S4b,S5,S6-200k,S7,S8"
SIZES = "256x256,640x480,1080p,4k"
SWEPT = "R100k,S2,S5"  # scenes on which parameters are swept
APPROACHED = "R4k,R100k"  # meshes that are seen from all distances
DISTANCES = "0.35,0.5,0.7,1,2,4,8,16"  # times that from where all of the mesh is in the picture
MOVED = "R16k-close,R100k,Rcourtyard"  # meshes that the camera goes around
SIZE = variant_tables.SIZE  # of all but the first part

Measured = Iterator[tuple[Key, Callable[[], list[Row]]]]


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--parts", default="all", help=f"of the report: {', '.join(PARTS)}, or all (default %(default)s)")
    parser.add_argument("--scenes", default=SCENES, help="names separated by commas, or all (default %(default)s)")
    parser.add_argument("--size", type=option_types.listed(option_types.size), default=SIZES, help="default %(default)s")
    parser.add_argument("--sweep", default=SWEPT, help="scenes on which parameters are swept (default %(default)s)")
    parser.add_argument("--approach", default=APPROACHED, help="meshes seen from all distances (default %(default)s)")
    parser.add_argument(
        "--distances", type=option_types.listed(distance), default=DISTANCES, help="1: all is in view (default %(default)s)"
    )
    parser.add_argument("--move", default=MOVED, help="meshes that the camera goes around (default %(default)s)")
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu", help="default %(default)s")
    parser.add_argument("--seconds", type=option_types.seconds, default=0.15, help="each variant, each case (default 0.15)")
    parser.add_argument("--total", type=option_types.seconds, default=math.inf, help="s, after which the rest is left out")
    parser.add_argument("--no-counters", action="store_true", help="times alone")
    parser.add_argument("--csv", type=option_types.csv_file, metavar="FILE", help="write the rows there")
    parser.add_argument("--rows", type=Path, nargs="+", metavar="FILE", help="take the rows from there and measure nothing")
    parser.add_argument("--predict", metavar="SCENES", help="with --rows: say from the counters which variant wins, then measure")
    parser.add_argument("--docs", type=Path, metavar="PAGE", help="put the tables there, between their markers")
    options = parser.parse_args(argv)
    if options.predict and not options.rows:
        parser.error("--predict needs --rows")
    if options.device not in native.devices() and (options.predict or not options.rows):
        parser.error(f"--device must be one of {', '.join(native.devices())}, as bigtri is built here, got {options.device}")
    known = list(scenes.SCENES)
    try:
        options.parts = option_types.chosen("part", options.parts, list(PARTS))
        options.scenes, options.sweep = (option_types.chosen("scene", each, known) for each in (options.scenes, options.sweep))
        real = (option_types.chosen("mesh", each, list(scenes.REAL)) for each in (options.approach, options.move))
        options.approach, options.move = real
        predicted = option_types.chosen("scene", options.predict, known) if options.predict else []
    except ValueError as error:
        parser.error(str(error))
    failures: list[str] = []
    if options.rows:
        rows = [row for path in options.rows for row in read(path)]
        for key in (Key(scene, *size) for scene in predicted for size in options.size):
            rows = [row for row in rows if row.part != PREDICTION or row.key != key]
            rows += predict(rows, key, options.device, options.seconds)
        if options.csv:
            write(options.csv, rows)
    else:
        rows = measured(options, here(options.device), failures)
    for failure in failures:
        print("FAILED", failure)
    if not rows:
        parser.error("nothing was measured")
    if options.docs:
        markdown.paste(options.docs, f"variants {options.device}", variant_tables.page(rows, SLOW[options.device]))
    wrong = [row for row in rows if not row.equal]
    for row in wrong:
        print(f"NOT EQUAL: {row.key} {row.variant} {row.setting}")
    return 1 if wrong or failures else 0


def distance(text: str) -> str:
    """An argparse type: a positive number, as short as it can be written."""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not 0 < number < math.inf:
        raise argparse.ArgumentTypeError(f"must be a positive number, got {text!r}")
    return f"{number:g}"


def here(device: str) -> dict[str, str]:
    """What rows say about where they come from."""
    on_cpu = f"{torch.get_num_threads()} threads, {native.isa()}"
    return {
        "device": provenance.device(device),
        "how": on_cpu if device == "cpu" else f"graph replay, driver {cuda_clock.driver()}",
        "versions": provenance.versions(),
        "commit": os.environ.get("BIGTRI_COMMIT") or provenance.commit(),  # a copy without .git is told its commit
        "command": provenance.command(),
    }


def measured(options: Any, where: Mapping[str, str], failures: list[str]) -> list[Row]:
    """The rows of all parts. A case that fails is added to the failures, and the next one goes on."""
    end = time.perf_counter() + options.total
    if options.device == "cuda":
        cuda_clock.warm_up()
    rows: list[Row] = []
    todo = [each for part in options.parts for each in PART[part](options, where)]
    for number, (key, call) in enumerate(todo):
        if time.perf_counter() > end:
            print(f"--total is over: {len(todo) - number} cases left out, from {key.scene} {key.size}")
            break
        try:
            found = call()
        except ValueError as error:  # the image is too small for the scene
            print(f"{key.scene}: {error}")
            continue
        except RuntimeError as error:
            failures.append(f"{key.scene} {key.size}: {str(error).splitlines()[0]}")
            continue
        rows += found
        fastest = sorted(found, key=lambda row: row.us)
        shown = ", ".join(f"{row.variant} {row.setting}".strip() + f" {text_of(row.timing.median)}" for row in fastest[:12])
        print(f"{found[0].part:10} {key.scene:14} {key.size:>9}, ms: {shown}", flush=True)
        if options.csv:
            write(options.csv, rows)
    return rows


def the_scenes(options: Any, where: Mapping[str, str]) -> Measured:
    settings = [tune.Setting(name) for name in native.VARIANTS[options.device]]
    for name in options.scenes:
        for size in options.size:
            yield of_settings("scenes", Key(name, *size), settings, options, where)


def the_parameters(options: Any, where: Mapping[str, str]) -> Measured:
    settings = sweep(native.REGISTRY[options.device][DEFAULT])
    for name in options.sweep:
        yield of_settings("parameters", Key(name, *SIZE), settings, options, where)


def the_distances(options: Any, where: Mapping[str, str]) -> Measured:
    settings = [tune.Setting(name) for name in native.VARIANTS[options.device]]
    for name in options.approach:
        for at in options.distances:
            yield of_settings("distance", Key(f"{name}@{at}", *SIZE), settings, options, where)


def of_settings(
    part: str, key: Key, settings: Sequence[tune.Setting], options: Any, where: Mapping[str, str]
) -> tuple[Key, Callable[[], list[Row]]]:
    def call() -> list[Row]:
        return Case(key, options.device).measure(part, settings, options.seconds, where, count=not options.no_counters)

    return key, call


def the_motion(options: Any, where: Mapping[str, str]) -> Measured:
    variants = native.VARIANTS[options.device]
    for key in (Key(name, *SIZE) for name in options.move):
        yield key, partial(moved, key, options.device, lambda case: case.motion(variants, options.seconds, where))


def the_stages(options: Any, where: Mapping[str, str]) -> Measured:
    variants = native.VARIANTS[options.device]
    for key in (Key(name, *SIZE) for name in options.move):
        yield key, partial(moved, key, options.device, lambda case: case.stages(variants, where))


def moved(key: Key, device: str, measure: Callable[[Moving], list[Row]]) -> list[Row]:
    return measure(Moving(key, device))


PART = {
    "scenes": the_scenes,
    "parameters": the_parameters,
    "distance": the_distances,
    "motion": the_motion,
    "stages": the_stages,
}


def predict(rows: Sequence[Row], key: Key, device: str, seconds: float) -> list[Row]:
    """Says from the counters which variant wins, then measures.

    Raises:
        SystemExit: the scene is in the report, or nothing was counted that its costs could be made from.
    """
    report = [row for row in rows if row.part != PREDICTION]
    if key.scene in {row.key.scene.partition("@")[0] for row in report}:
        raise SystemExit(f"--predict: {key.scene} is in the report, so nothing would be predicted")
    known = [row for row in report if row.part == "scenes" and row.counters]
    costs = {variant: fit(of_it) for variant, of_it in by_variant(known).items()}
    settings = [tune.Setting(variant) for variant in native.VARIANTS[device] if variant in costs]
    if not settings:
        raise SystemExit("--predict: the rows have no counters")
    case, where, none = Case(key, device), here(device), clock.summary([0])
    counted = [Row(PREDICTION, *case.known, s.variant, "predicted", none, True, case.counted(s), None, where) for s in settings]
    said = [row._replace(timing=clock.summary([costs[row.variant].us(row) / 1e3])) for row in counted]
    print(f"{key.scene} {key.size}, predicted: {in_order(said)}", flush=True)
    found = case.measure(PREDICTION, settings, seconds, where, count=False)
    print(f"{key.scene} {key.size}, measured:  {in_order(found)}", flush=True)
    return [*said, *(row._replace(setting="measured") for row in found)]


def in_order(rows: Sequence[Row]) -> str:
    ms = {row.variant: row.timing.median for row in rows}
    return ", ".join(f"{variant} {text_of(ms[variant])} ms" for variant in sorted(ms, key=ms.__getitem__))


if __name__ == "__main__":
    sys.exit(main())
