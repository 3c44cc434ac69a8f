"""The command line: ``bigtri render``, ``info``, ``bench``, ``compare``, ``tune``, ``accuracy``, ``demo`` and ``hard-cases``.

A command imports what it needs when it runs, so that --help, --version and a wrong command line are answered without torch.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .. import __version__
from . import arguments, render_options

# Exit codes: 0 done; 1 it cannot be done here, or compare or hard-cases found bigtri wrong; 2 the command line or a file is
# wrong, which is argparse's own code for that.
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
            if words[:1] == ["compare"]:
                command = "compare"
                from . import compare

                return compare.main(words[1:])
            if words[:1] == ["tune"]:
                command = "tune"
                from . import tune

                return tune.main(words[1:])
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
    about = "pictures of a 3D model, and how far away everything is"
    render = commands.add_parser("render", help=about, epilog=render_options.EXAMPLES, formatter_class=raw)
    render_options.add_arguments(render)
    render.set_defaults(run=_render)
    about = "what a model file holds and what of it is drawn; without one, versions, processor and build, for a bug report"
    info = commands.add_parser("info", help=about, description=about)
    info.add_argument("model", type=Path, nargs="?", help="a GLB, glTF, OBJ, PLY, STL or OFF file")
    info.set_defaults(run=_info)
    about = "which effects a model calls for, why, and what each of them costs"
    explain = commands.add_parser("explain", help=about, description=about)
    explain.add_argument("model", type=Path, help="a GLB, glTF, OBJ, PLY, STL or OFF file")
    explain.add_argument("--size", type=arguments.size, default=(1280, 720), metavar="WxH", help="pixels (default: 1280x720)")
    explain.set_defaults(run=_explain)
    commands.add_parser("bench", help="measure how fast rasterize is on this machine; see bigtri bench --help")
    about = "every variant on one scene: time, work, and whether it draws what the reference draws; see bigtri compare --help"
    commands.add_parser("compare", help=about)
    about = "measure which variant and parameters draw a scene fastest on this machine, and keep it; see bigtri tune --help"
    commands.add_parser("tune", help=about)
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


def _render(options: argparse.Namespace) -> int:
    _set_threads(options.threads)
    from . import pictures

    for path in pictures.run(options, _say):
        print(path)
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


def _explain(options: argparse.Namespace) -> int:
    from ..scene import load_scene
    from ..scene.camera import Camera

    _say(f"reading {options.model}")
    scene = load_scene(options.model)
    width, height = options.size
    print(scene.plan(Camera.framing(scene.bounds, aspect=width / height), (height, width)))
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


def _set_threads(threads: int | None) -> None:
    if threads is not None:
        import torch

        torch.set_num_threads(threads)


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    _say(f"bigtri: warning: {message}")
