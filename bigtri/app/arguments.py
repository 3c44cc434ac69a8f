"""What the command lines share: types for argparse, and the options that several commands have. Imports no torch."""

from __future__ import annotations

import argparse
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from ..choices import BACKENDS

MAX_THREADS = 1024  # beyond, systems refuse to start them, and then the process ends
T = TypeVar("T")


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
    from ..reference.numerics import MAX_SIZE  # brings NumPy, for which --help need not wait

    named = {"1080p": "1920x1080", "4k": "3840x2160", "8k": "7680x4320", "16k": "15360x8640"}.get(text.lower(), text)
    width, _, height = named.lower().partition("x")
    try:
        return whole(1, MAX_SIZE)(width), whole(1, MAX_SIZE)(height)
    except argparse.ArgumentTypeError:
        wanted = f"WIDTHxHEIGHT, 1 to {MAX_SIZE} each, such as 1920x1080, or 1080p, 4k, 8k, 16k"
        raise argparse.ArgumentTypeError(f"must be {wanted}, got {text!r}") from None


def color(text: str) -> tuple[int, int, int]:
    """An argparse type: sRGB codes from "255,128,0", "#ff8000", "#f80" or a name of CSS."""
    if len(parts := text.split(",")) == 3:
        red, green, blue = (whole(0, 255)(part.strip()) for part in parts)
        return red, green, blue
    from PIL import ImageColor  # for which --help need not wait

    try:
        codes: tuple[int, ...] = ImageColor.getrgb(text)
    except ValueError:
        codes = ()
    if len(codes) != 3:  # unknown, or with an alpha
        wanted = "a name such as white, red,green,blue from 0 to 255, or #rrggbb (in quotes)"
        raise argparse.ArgumentTypeError(f"must be {wanted}, got {text!r}")
    return codes[0], codes[1], codes[2]


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


def add_execution(parser: argparse.ArgumentParser) -> None:
    """Adds --backend and --threads."""
    group = parser.add_argument_group("execution (never changes a pixel)")
    group.add_argument("--backend", choices=BACKENDS, default="auto", help="default: native where it is built")
    group.add_argument("--threads", type=count, metavar="N", help="threads to use (default: torch's)")
