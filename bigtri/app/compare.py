"""``bigtri compare``: every variant on one scene, held against the reference and timed."""

from __future__ import annotations

import argparse
import runpy
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ..choices import CULLS
from ..precision import DEFAULT, PRECISIONS
from ..study import scenes
from . import arguments, render_options

if TYPE_CHECKING:
    from ..study.accuracy import Case
    from ..study.compare import Row

_DIFFERS = 1  # exit code


def parser(program: str = "bigtri compare") -> argparse.ArgumentParser:
    result = argparse.ArgumentParser(
        prog=program,
        description="Draws a scene with every variant, compares each picture with the reference's in bits, and shows times and "
        "work side by side. Exit code 1 if one differs; the first stage, bin, tile and pixel that do are named.",
        epilog=f"scenes: those of bigtri bench, and the hard cases of bigtri accuracy\n\nexamples:\n"
        f"  {program} S2 --size 1080p\n"
        f"  {program} --variants bin_owned,two_stage scan.ply --azimuth 120\n"
        f"  {program} Rcourtyard --device cuda --precision fast\n"
        f"  {program} S3 --size 640x360 --plots plots\n"
        f"  {program} S2 --load mine.py --variants mine,bin_owned --size 320x240",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    result.add_argument("scene", metavar="SCENE", help="a model file, or the name of a scene")
    result.add_argument("--variants", default="all", help="names separated by commas, or all (default all)")
    about = "Python to run first, which registers variants of your own (docs/validate.md)"
    result.add_argument("--load", type=Path, metavar="FILE", help=about)
    result.add_argument("--size", type=arguments.size, default=(1280, 720), metavar="WxH", help="pixels (default: 1280x720)")
    result.add_argument("--device", choices=("cpu", "cuda"), default="cpu", help="where to draw (default %(default)s)")
    result.add_argument("--precision", choices=PRECISIONS, metavar="RUNG", default=DEFAULT, help="rung (default %(default)s)")
    result.add_argument("--cull", choices=CULLS, default="none", help="faces not to draw (default: none)")
    result.add_argument("--threads", type=arguments.count, metavar="N", help="threads to use (default: torch's)")
    result.add_argument("--isa", default="", help="instruction set of the CPU (default: the fastest)")
    result.add_argument("--seed", type=arguments.seed, default=scenes.SEED, help="of a named scene (default %(default)s)")
    result.add_argument("--seconds", type=arguments.seconds, default=0.5, help="of the clock, each variant (default 0.5)")
    about = "also draw there where each variant does its work, overdraw, and the load of tasks; needs matplotlib"
    result.add_argument("--plots", type=Path, metavar="FOLDER", help=about)
    camera = result.add_argument_group("camera, for a model file")
    about = "degrees around the up axis (default: 30)"
    camera.add_argument("--azimuth", type=float, nargs=1, metavar="DEGREES", help=about)
    render_options.add_camera(camera)
    return result


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``bigtri compare``; returns the exit code.

    Raises:
        SystemExit: argparse's, for --help and for what cannot be drawn: an unknown name, a rung that is not compiled.
        OSError, ValueError: a file that cannot be read.
        ImportError: --plots without matplotlib.
        RuntimeError: --plots with a rung whose work is not counted.
    """
    command = parser()
    options = command.parse_args(argv)

    import torch  # only now: what is wrong with the command line is said at once

    from .. import native
    from ..check.registered import registered_variants
    from ..study import clock, provenance
    from ..study.compare import Job, compare

    if not native.available():
        command.error(f"the extension is not built: {native.load_error()}")
    rungs = native.REGISTRY.get(options.device)
    if rungs is None:
        built = ", ".join(native.REGISTRY)
        command.error(f"--device must be one of {built}, as the extension is built here, got {options.device}")
    if options.precision not in rungs:
        command.error(f"--precision must be one of {', '.join(rungs)}, as the extension is built here, got {options.precision}")
    if options.plots:
        if options.device == "cuda" and not native.counting_on_cuda():
            command.error("--plots with --device cuda needs the extension built with BIGTRI_CUDA_COUNTING=1")
        from ..study import work_plots  # without matplotlib it is said before anything is drawn
    if options.load:
        runpy.run_path(str(options.load))
    try:
        own = registered_variants() if options.load else {}
        variants = arguments.chosen("variant", options.variants, [*rungs[options.precision], *own])
        counted = [variant for variant in variants if variant not in own]
        if options.plots and not counted:
            raise ValueError("--plots must be given with a variant of the extension, which counts its work")
        if options.isa:
            arguments.chosen("instruction set", options.isa, native.isa_levels())
        case = case_of(options.scene, options.size, options)
    except ValueError as error:
        command.error(str(error))
    job = Job(case.positions, case.triangles, (case.height, case.width), options.device, options.precision, options.cull)
    threads = options.threads or torch.get_num_threads()
    print(f"{provenance.device(options.device)}; {provenance.versions()}; {provenance.commit()}")
    how = f"{threads} threads, {options.isa or native.isa()}" if options.device == "cpu" else options.device
    print(f"{case.name}, {len(case.triangles)} triangles, {case.width}x{case.height} px, {options.precision}, {how}", flush=True)
    with clock.setting(threads, options.isa or None):
        plots = []
        if options.plots:  # what is not counted is said before anything is timed
            plots = work_plots.draw_all(job, case.name, counted, options.plots)
        rows = compare(job, variants, options.seconds)
    print(table(rows))
    for path in plots:
        print(path)
    return _DIFFERS if any(row.differences for row in rows) else 0


def table(rows: Sequence[Row]) -> str:
    """Times, one line a variant; then the counters, one line each; then what differs."""
    wide = max(len(row.variant) for row in rows)
    lines = [f"\n{'variant':{wide}} {'median ms':>10} {'min':>9} {'p25':>9} {'p75':>9}  equal"]
    for row in rows:
        t = row.timing
        equal = "NO" if row.differences else "yes"
        lines.append(f"{row.variant:{wide}} {t.median:10.4f} {t.minimum:9.4f} {t.p25:9.4f} {t.p75:9.4f}  {equal}")
    counted = [row for row in rows if row.counters]
    if names := list(dict.fromkeys(name for row in counted for name in row.counters)):
        first = max(map(len, names))
        columns = [max(len(row.variant), 13) for row in counted]
        lines.append("\n" + " ".join([" " * first, *(f"{row.variant:>{w}}" for row, w in zip(counted, columns, strict=True))]))
        for name in names:
            values = (f"{row.counters[name]:,}" if name in row.counters else "" for row in counted)
            lines.append(" ".join([f"{name:{first}}", *(f"{v:>{w}}" for v, w in zip(values, columns, strict=True))]))
    for row in rows:
        lines += [f"\n{row.variant}:", *(f"  {line}" for line in row.differences)] if row.differences else []
    return "\n".join(lines)


def case_of(name: str, size: tuple[int, int], options: argparse.Namespace) -> Case:
    """The scene of that name, or the model in that file, in so many px; ``options``: --seed, and those of the camera.

    Raises:
        ValueError: options of the camera without a model file; neither such a scene nor such a file.
    """
    from ..scene import load_scene
    from ..study import accuracy
    from . import pictures

    width, height = size
    if name in accuracy.HARD or name in scenes.SCENES:
        if given := [option for option in pictures.CAMERA if pictures.is_given(options, option)]:
            raise ValueError(f"--{given[0]} must be given with a model file, got the scene {name}")
        return accuracy.case(name, width, height, options.seed)
    path = Path(name)
    if not path.suffix and not path.exists():
        names = ", ".join([*scenes.SCENES, *accuracy.HARD])
        raise ValueError(f"SCENE must be a model file or one of {names}, got {name!r}")
    pictures.check_together(options)
    print(f"reading {path}", file=sys.stderr)
    scene = load_scene(path)
    (camera,) = pictures.cameras_of(argparse.Namespace(**vars(options), turntable=None), scene, width / height)
    return accuracy.Case(path.name, width, height, camera.transform(scene.positions, width / height), scene.triangles)
