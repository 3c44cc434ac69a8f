"""The command line: ``bigtri render``, ``info``, ``bench``, ``accuracy``, ``demo`` and ``hard-cases``.

A command imports what it needs when it runs, so that --help, --version and a wrong command line are answered without torch.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .. import __version__
from ..choices import CULLS, VIEWS
from . import arguments

# Exit codes: 0 done; 1 it cannot be done here, or hard-cases found bigtri wrong; 2 the command line or a file is wrong, which is
# argparse's own code for that.
_FAILED = 1
_WRONG_INPUT = 2

_EXAMPLES = """\
examples:
  bigtri render model.glb -o model.png
  bigtri render model.obj -o views.png --view all --size 1920x1080
  bigtri demo --out pictures
  bigtri info model.glb
  bigtri info
"""

_RENDER_EXAMPLES = """\
examples:
  bigtri render duck.glb -o duck.png
  bigtri render duck.glb -o duck.png --size 1920x1080 --azimuth 120 --elevation 10 --supersample 3
  bigtri render duck.glb -o duck.png --view all       writes duck-shaded.png, duck-normals.png, ...
  bigtri render scan.ply -o scan.png --up z --view bins
"""


_HARD_CASES_EXAMPLES = """\
examples:
  bigtri hard-cases                            all of them: a minute or two
  bigtri hard-cases --only ties depth H13
  bigtri hard-cases --csv hard_cases.csv
  bigtri hard-cases --pictures pictures
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code. What can be expected to go wrong is one line, not a traceback.

    Raises:
        SystemExit: argparse's, for a command line that it does not understand, and for --help.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    command = "bench"
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _show_warning
            if words[:1] == ["bench"]:
                # The benchmark and the study have parsers of their own, --help included.
                from . import bench

                return bench.main(words[1:])
            if words[:1] == ["accuracy"]:
                command = "accuracy"
                from . import accuracy

                return accuracy.main(words[1:])
            options = _parser().parse_args(words)
            command = options.command
            return options.run(options)
    except (OSError, ValueError, TypeError) as error:
        return _complain(command, error, _WRONG_INPUT)
    except (RuntimeError, ImportError, MemoryError) as error:
        return _complain(command, error, _FAILED)
    except KeyboardInterrupt:
        return _complain(command, "interrupted", _FAILED)


def _complain(command: str, what: object, code: int) -> int:
    """Say it in one line; returns the code."""
    text = " ".join(str(what).split()) or type(what).__name__
    print(f"bigtri {command}: {text}", file=sys.stderr)
    return code


def _parser() -> argparse.ArgumentParser:
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(
        "bigtri", description="Exact software rasterization of large triangles.", epilog=_EXAMPLES, formatter_class=raw
    )
    parser.add_argument("--version", action="version", version=f"bigtri {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    _add_render(commands.add_parser("render", help="a picture of a 3D model", epilog=_RENDER_EXAMPLES, formatter_class=raw))
    about = "what a model file holds and what of it is drawn; without one, versions, processor and build, for a bug report"
    info = commands.add_parser("info", help=about, description=about)
    info.add_argument("model", type=Path, nargs="?", help="a GLB, glTF, OBJ, PLY, STL or OFF file")
    info.set_defaults(run=_info)
    commands.add_parser("bench", help="measure how fast rasterize is on this machine; see bigtri bench --help")
    about = "what each rung of accuracy gets wrong, and its time, on this machine; see bigtri accuracy --help"
    commands.add_parser("accuracy", help=about)
    about = "draw, explain and time a scene of large triangles"
    demo = commands.add_parser("demo", help=about, epilog="example:\n  bigtri demo --out pictures", formatter_class=raw)
    demo.add_argument("--out", type=Path, default=Path("bigtri-demo"), help="folder for the pictures (default: %(default)s)")
    demo.add_argument("--size", type=arguments.size, default=(1920, 1080), metavar="WxH", help="pixels (default: 1920x1080)")
    arguments.add_execution(demo)
    demo.set_defaults(run=_demo)
    about = "what this build draws of triangles that break rasterizers, and what plain float32 draws"
    _add_hard_cases(commands.add_parser("hard-cases", help=about, epilog=_HARD_CASES_EXAMPLES, formatter_class=raw))
    return parser


def _add_hard_cases(parser: argparse.ArgumentParser) -> None:
    parser.description = "Draw every hard case by every method and count what is wrong. Exit code 1 if bigtri is wrong anywhere."
    parser.add_argument("--only", nargs="+", default=[], metavar="NAME", help="cases such as H05, or families such as ties")
    parser.add_argument("--csv", type=arguments.csv_file, metavar="FILE", help="write the counts there as well")
    parser.add_argument("--markdown", action="store_true", help="print the table as docs/hard_cases.md has it")
    parser.add_argument("--pictures", type=Path, metavar="DIR", help="draw the pictures of docs/hard_cases.md there, no table")
    parser.set_defaults(run=_hard_cases)


def _add_render(parser: argparse.ArgumentParser) -> None:
    parser.description = "Draw a GLB, glTF, OBJ, PLY, STL or OFF file, seen from around it."
    parser.add_argument("model", type=Path, help="the file to draw")
    parser.add_argument("-o", "--out", type=Path, required=True, help="the picture to write: .png, .jpg, .tif or .bmp")
    parser.add_argument("--strict", action="store_true", help="draw nothing if the file has what the picture would not show")
    parser.add_argument("--size", type=arguments.size, default=(1280, 960), metavar="WxH", help="pixels (default: 1280x960)")
    parser.add_argument("--view", choices=(*VIEWS, "all"), default="shaded", help="what to show (default: %(default)s)")
    camera = parser.add_argument_group("camera")
    camera.add_argument("--azimuth", type=float, default=30.0, help="degrees around the up axis (default: %(default)g)")
    camera.add_argument("--elevation", type=float, default=20.0, help="degrees above the horizon (default: %(default)g)")
    camera.add_argument("--distance", type=float, default=1.0, help="1 fits the model, 2 is twice as far (default: %(default)g)")
    camera.add_argument("--fov", type=float, default=40.0, help="vertical field of view, degrees (default: %(default)g)")
    camera.add_argument("--up", choices=("y", "z"), default="y", help="the model's up axis (default: %(default)s)")
    quality = parser.add_argument_group("quality")
    quality.add_argument(
        "--supersample",
        type=arguments.whole(1),
        default=2,
        metavar="N",
        help="NxN samples a pixel, shaded view only (default: 2)",
    )
    quality.add_argument("--cull", choices=CULLS, default="none", help="faces not to draw (default: none)")
    arguments.add_execution(parser)
    parser.set_defaults(run=_render)


def _render(options: argparse.Namespace) -> int:
    _set_threads(options.threads)
    from ..reference.numerics import MAX_SIZE
    from ..rendering import figure
    from ..rendering.views import picture
    from ..scene import load_scene
    from ..scene.camera import Camera

    _check_picture_path(options.out)
    started = time.perf_counter()
    width, height = options.size
    most = MAX_SIZE // max(width, height)
    if options.view in ("shaded", "all") and options.supersample > most:
        raise ValueError(f"--supersample must be at most {most} at {width}x{height} px, got {options.supersample}")
    _say(f"reading {options.model}")
    scene = load_scene(options.model, strict=options.strict).with_(cull=options.cull)
    _say(f"{len(scene.triangles)} triangles, {len(scene.used_materials)} materials")
    camera = Camera.framing(
        scene.bounds, options.azimuth, options.elevation, options.distance, width / height, options.fov, options.up
    )
    views = VIEWS if options.view == "all" else (options.view,)
    for view in views:
        path = options.out.with_stem(f"{options.out.stem}-{view}") if options.view == "all" else options.out
        _say(f"drawing {view}")
        drawn = picture(view, scene, camera, (height, width), backend=options.backend, supersample=options.supersample)
        print(figure.save(path, drawn))
    _say(f"done in {time.perf_counter() - started:.1f} s")
    return 0


def _info(options: argparse.Namespace) -> int:
    if options.model is not None:
        from . import model_info

        _say(f"reading {options.model}")
        print(model_info.describe(options.model))
    else:
        from . import info

        print(info.describe())
    return 0


def _demo(options: argparse.Namespace) -> int:
    _set_threads(options.threads)
    from .demo import run

    width, height = options.size
    paths = run(options.out, (height, width), options.backend, _say)
    for path in paths:
        print(path)
    return 0


def _hard_cases(options: argparse.Namespace) -> int:
    from ..hard_cases import pictures, report

    if options.pictures:
        for path in pictures.draw_all(options.pictures, _say):
            print(path)
        return 0
    rows = report.measure_all(report.choose(options.only), _say)
    print(report.markdown(rows) if options.markdown else report.table(rows))
    if options.csv:
        options.csv.write_text(report.as_csv(rows), encoding="utf-8")
    wrong = report.failures(rows)
    _say("bigtri: nothing wrong" if not wrong else f"bigtri: {wrong} WRONG: please report this")
    return _FAILED if wrong else 0


def _check_picture_path(path: Path) -> None:
    """Complain before the work is done, not after."""
    kinds = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
    if path.suffix.lower() not in kinds:
        raise ValueError(f"--out must end in {', '.join(kinds)}, got {path.name!r}")
    if not path.parent.is_dir():
        raise ValueError(f"--out must be in a folder that is there, got {path.parent}: make it first")
    if path.is_dir():
        raise ValueError(f"--out must be a file, got the folder {path}")


def _set_threads(threads: int | None) -> None:
    if threads is not None:
        import torch

        torch.set_num_threads(threads)


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    _say(f"bigtri: warning: {message}")
