"""``bigtri tune``: measures which variant and parameters are fastest for a scene on this machine, and keeps it."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ..precision import DEFAULT, PRECISIONS
from ..study import scenes
from . import arguments, render_options

if TYPE_CHECKING:
    from ..ops.tuned import File, Measured
    from ..study.accuracy import Case


def parser(program: str = "bigtri tune") -> argparse.ArgumentParser:
    result = argparse.ArgumentParser(
        prog=program,
        description="Measures which variant and parameters draw a scene fastest on this machine, and keeps that in a file. "
        "bigtri.use_tuning() reads it; from then on variant='auto' draws calls of that kind so. The bits stay the same.",
        epilog=f"examples:\n"
        f"  {program} scan.ply --size 640x480,1080p\n"
        f"  {program} R4k R100k S2 --device cuda --views 64 --size 256x256\n"
        f"  {program} --list\n"
        f"  {program} --forget",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    result.add_argument("scenes", nargs="*", metavar="SCENE", help="model files, or names of scenes")
    result.add_argument("--size", type=arguments.listed(arguments.size), default="1280x720", help="WxH,... (default %(default)s)")
    result.add_argument(
        "--views", type=arguments.whole(1, 65536), default=1, help="of a call, all the same (default %(default)s)"
    )
    result.add_argument("--device", choices=("cpu", "cuda"), default="cpu", help="where to draw (default %(default)s)")
    result.add_argument("--precision", choices=PRECISIONS, metavar="RUNG", default=DEFAULT, help="rung (default %(default)s)")
    result.add_argument("--threads", type=arguments.count, metavar="N", help="of the CPU (default: torch's)")
    result.add_argument("--seed", type=arguments.seed, default=scenes.SEED, help="of a named scene (default %(default)s)")
    result.add_argument("--seconds", type=arguments.seconds, default=1.0, help="of the last round of each scene (default 1)")
    kept = result.add_argument_group("what is kept")
    kept.add_argument("--file", type=Path, help="where (default: BIGTRI_TUNING, else tuning.json in the folder for caches)")
    kept.add_argument("--list", action="store_true", help="show it and measure nothing")
    kept.add_argument("--forget", action="store_true", help="remove these scenes from it; the whole file without a SCENE")
    camera = result.add_argument_group("camera, for a model file")
    camera.add_argument("--azimuth", type=float, nargs=1, metavar="DEGREES", help="degrees around the up axis (default: 30)")
    render_options.add_camera(camera)
    return result


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``bigtri tune``; returns the exit code.

    Raises:
        SystemExit: argparse's, for --help and for what cannot be drawn: an unknown name, a rung that is not compiled.
        OSError, ValueError: a file that cannot be read or written.
    """
    command = parser()
    options = command.parse_args(argv)
    if options.list and options.forget:
        command.error("--list and --forget: give one of them")
    if not options.scenes and not options.list and not options.forget:
        command.error("give a SCENE, --list or --forget")

    from ..ops import tuned

    path = options.file or tuned.default_path()
    if options.list:
        return _list(path, options.scenes)
    if options.forget:
        return _forget(path, options.scenes)
    return _measure(command, options, path)


def _measure(command: argparse.ArgumentParser, options: argparse.Namespace, path: Path) -> int:
    import torch

    from .. import native
    from ..ops import tuned
    from ..study import clock, provenance
    from ..study.tune import Job, tune
    from .compare import case_of

    if not native.available():
        command.error(f"the extension is not built: {native.load_error()}")
    if options.device not in native.devices():
        command.error(f"--device must be one of {', '.join(native.devices())}, as bigtri is built here, got {options.device}")
    rungs = native.REGISTRY[options.device]
    if options.precision not in rungs:
        command.error(f"--precision must be one of {', '.join(rungs)}, as the extension is built here, got {options.precision}")
    file = _kept(path)
    try:
        cases = [case_of(scene, size, options) for scene in options.scenes for size in options.size]
    except ValueError as error:
        command.error(str(error))

    print(f"{provenance.device(options.device)}; {provenance.versions()}; {provenance.commit()}")
    index = torch.cuda.current_device() if options.device == "cuda" else -1
    name, build = tuned.devices()[index], tuned.build(options.device)
    if file.builds.get(name, build) != build:
        print(f"what {path} has of another build is dropped")
        file.measured[name] = []
    file.builds[name] = build
    for case in cases:
        positions = torch.from_numpy(case.positions).to(options.device)
        if options.views > 1:
            positions = positions.repeat(options.views, 1, 1)
        triangles = torch.from_numpy(case.triangles).to(options.device)
        job = Job(case.name, positions, triangles, (case.height, case.width), options.precision)
        with clock.setting(options.threads or torch.get_num_threads()):
            found = tune(job, options.seconds, _progress)
        print(f"\n{table(found)}\n{statistics(case, options.precision)}", flush=True)
        before = file.measured.setdefault(name, [])
        file.measured[name] = [each for each in before if _what(each) != _what(found)] + [found]
        tuned.write(path, file)  # now: what follows may be interrupted
    print(f"\nkept in {path}; bigtri.use_tuning() reads it, bigtri tune --forget removes it")
    return 0


def table(measured: Measured) -> str:
    """The ways of one scene, the standard one first; what "auto" would take is marked."""
    from ..ops import tuned

    best = tuned.best([measured])
    where = f"{measured.threads} threads, {measured.isa}" if measured.threads else "GPU"
    lines = [
        f"{measured.scene}, {measured.triangles} triangles, {measured.width}x{measured.height} px, {measured.views} "
        f"view{'s' * (measured.views != 1)}, {measured.precision}, {where}, {measured.date}",
        f"{'us':>12} {'x standard':>10}",
    ]
    for number, way in enumerate(measured.ways):
        mark = "  <- taken" if way == (best or measured.ways[0]) else ""
        name = f"{way.name} (standard)" if number == 0 else way.name
        lines.append(f"{way.us:12.2f} {way.ratio:10.3f}  {name}{mark}")
    return "\n".join(lines)


def statistics(case: Case, precision: str) -> str:
    """What the scene is like, from what the CPU's standard variant counts of one view; empty where nothing is counted."""
    from .. import native
    from ..check import counters

    variant = next(iter(native.REGISTRY["cpu"][precision])) if precision in native.REGISTRY["cpu"] else ""
    try:
        size = case.height, case.width
        found = counters.count(case.positions, case.triangles, size, variant=variant, backend="native", precision=precision)
    except (RuntimeError, ValueError):
        return ""
    records, fragments = found.get("records", 0), found.get("fragments", 0)
    return (
        f"a view has {records} records, {found.get('by_tiles', 0)} of them large, in {found.get('entries', 0)} bins; it draws "
        f"{fragments / (case.height * case.width):.2f} fragments a pixel"
    )


def _what(measured: Measured) -> tuple[object, ...]:
    """What a new measurement replaces an old one of."""
    size = measured.width, measured.height, measured.views, measured.triangles
    return measured.scene, measured.precision, measured.threads, measured.isa, *size


def _list(path: Path, names: Sequence[str]) -> int:
    file = _kept(path)
    print(path if path.exists() else f"{path} is not there")
    for machine, scenes_of in file.measured.items():
        print(f"\n{machine}, measured with bigtri {file.builds[machine]}")
        for measured in scenes_of:
            if not names or measured.scene in names:
                print(f"\n{table(measured)}")
    return 0


def _forget(path: Path, names: Sequence[str]) -> int:
    from ..ops import tuned

    if not names:
        path.unlink(missing_ok=True)
        print(f"{path} is removed")
        return 0
    file = _kept(path)
    gone = 0
    for machine, scenes_of in file.measured.items():
        file.measured[machine] = [measured for measured in scenes_of if measured.scene not in names]
        gone += len(scenes_of) - len(file.measured[machine])
    tuned.write(path, file)
    print(f"{gone} measurements removed from {path}")
    return 0


def _kept(path: Path) -> File:
    """What the file holds; nothing where there is none.

    Raises:
        OSError: it cannot be read.
        ValueError: it is broken; the text says so.
    """
    from ..ops import tuned

    try:
        return tuned.read(path)
    except FileNotFoundError:
        return tuned.File({}, {})
    except tuned.TuningError as error:
        raise ValueError(f"{path}: {error}; remove it by --forget") from None


def _progress(what: str) -> None:
    if sys.stderr.isatty():
        print(f"\r\033[K{what} ...\r", end="", file=sys.stderr, flush=True)
