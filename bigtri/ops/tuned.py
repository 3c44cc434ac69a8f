"""Ways to draw that ``bigtri tune`` has found faster than the standard one, for ``variant="auto"`` to take.

Nothing is read unless ``use_tuning`` is called. From then on ``rasterize`` looks its call up by what the host knows without
waiting: device, threads, precision, and the classes of the numbers of pixels, triangles and views. No bit ever changes.
"""

from __future__ import annotations

import functools
import hashlib
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import torch

from .. import __version__, machine, native, warn

FORMAT = 1  # of the file; another one is not read
LESS = 0.95  # of the standard way's time: what takes more is not worth another way
LEAST_US = 1.0  # what a way has to save in every scene of its class


class Way(NamedTuple):
    """A variant with parameters, and its time in one scene."""

    variant: str
    parameters: dict[str, int]
    us: float  # median
    ratio: float  # to the standard way's time, which three of four rounds in which they took turns stay below

    @property
    def name(self) -> str:
        return " ".join([self.variant, *(f"{name}={value}" for name, value in self.parameters.items())])


class Measured(NamedTuple):
    """One scene, drawn in several ways; the first one is the standard."""

    scene: str
    precision: str
    width: int  # px
    height: int  # px
    views: int
    triangles: int
    threads: int  # of the CPU; 0 on a GPU
    isa: str  # of the CPU; empty on a GPU
    date: str
    ways: list[Way]

    def key(self) -> Key:
        return key_of(self.precision, self.threads, self.height * self.width, self.triangles, self.views)


# Precision and threads, and the binary digits of the numbers of pixels, triangles and views: a class spans a factor of two.
Key = tuple[str, int, int, int, int]


class Choice(NamedTuple):
    variant: native.Variant
    values: list[int]  # as the operator takes them


Table = dict[Key, Choice]


class File(NamedTuple):
    """What ``bigtri tune`` keeps: by machine, the build that measured and its measurements."""

    builds: dict[str, str]
    measured: dict[str, list[Measured]]


class TuningError(ValueError):
    """A file that cannot be used; the text says why."""


# By the GPU's index, of the CPU as -1; empty where nothing is used. ``rasterize`` asks for no more than that at every call.
tables: dict[int, Table] = {}


def key_of(precision: str, threads: int, pixels: int, triangles: int, views: int) -> Key:
    return precision, threads, pixels.bit_length(), triangles.bit_length(), views.bit_length()


def default_path() -> Path:
    """The file that ``bigtri tune`` writes: what BIGTRI_TUNING says, else tuning.json in the user's folder for caches."""
    if given := os.environ.get("BIGTRI_TUNING"):
        return Path(given)
    if sys.platform == "win32":
        folder = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    elif sys.platform == "darwin":
        folder = Path.home() / "Library" / "Caches"
    else:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return folder / "bigtri" / "tuning.json"


def use_tuning(path: str | os.PathLike[str] | None = None) -> int:
    """From now on ``variant="auto"`` draws in the ways that ``bigtri tune`` has found faster here; the bits stay the same.

    A call is looked up by its device, threads, precision and the numbers of pixels, triangles and views; one like none that was
    measured is drawn in the standard way, as is one with ``parameters``. Under torch.compile everything is.

    Args:
        path: a file that ``bigtri tune`` has written; None: the one that it writes by itself.

    Returns:
        How many classes of calls are drawn in another way than the standard one. 0 also where the file is missing, broken or from
        another build or machine; a warning says so, once in the process.
    """
    stop_tuning()
    place = default_path() if path is None else Path(path)
    if not native.available():
        return 0  # the reference has one way to draw
    try:
        file = read(place)
        here = devices()
        known = {index: name for index, name in here.items() if name in file.measured}
        if not known:
            raise TuningError(f"it is about {', '.join(file.measured) or 'no device'}, here is {', '.join(here.values())}")
        found = {index: table(file, "cuda" if index >= 0 else "cpu", name) for index, name in known.items()}
    except (OSError, TuningError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        what = f"{place} is not used, so everything is drawn in the standard way: {why}"
        warn.once(f"tuning {place}", f"bigtri.use_tuning: {what}. `bigtri tune SCENE` measures this machine", RuntimeWarning)
        return 0
    tables.update(found)
    return sum(map(len, found.values()))


def stop_tuning() -> None:
    """``variant="auto"`` is the standard way again."""
    tables.clear()


def way_for(clip: torch.Tensor, faces: torch.Tensor, precision: str, shape: tuple[int, ...]) -> Choice | None:
    """The way to draw a picture of this shape, [H, W] or [B, H, W]; None: the standard one. Not while torch compiles."""
    index, threads = (clip.device.index, 0) if clip.is_cuda else (-1, torch.get_num_threads())
    found = tables.get(index)
    if not found or native.parameters_are_set():
        return None
    *views, height, width = shape
    return found.get(key_of(precision, threads, height * width, faces.shape[0], views[0] if views else 1))


def devices() -> dict[int, str]:
    """The names of the devices that the extension draws on here: by the GPU's index, and the CPU's as -1."""
    names = {-1: machine.cpu_name()}
    if "cuda" in native.devices():
        names |= {index: torch.cuda.get_device_name(index) for index in range(torch.cuda.device_count())}
    return names


def table(file: File, kind: str, name: str) -> Table:
    """The ways other than the standard one, for a kind of device and the name of one.

    Raises:
        TuningError: they are another build's, or no variant's.
    """
    if file.builds[name] != build(kind):
        raise TuningError(f"it was measured with bigtri {file.builds[name]}, and this is {build(kind)}")
    isa = native.isa() if kind == "cpu" else ""
    classes: dict[Key, list[Measured]] = {}
    for measured in file.measured.get(name, []):
        if measured.isa == isa and measured.precision in native.REGISTRY[kind]:
            classes.setdefault(measured.key(), []).append(measured)
    found = {}
    for key, scenes in classes.items():
        if way := best(scenes):
            variant = native.REGISTRY[kind][key[0]].get(way.variant)
            if variant is None:
                raise TuningError(f"there is no variant {way.variant!r} with precision {key[0]!r}")
            try:
                found[key] = Choice(variant, native.parameter_values("use_tuning", variant, way.parameters))
            except ValueError as error:
                raise TuningError(str(error)) from None
    return found


def best(scenes: Sequence[Measured]) -> Way | None:
    """The way whose worst ratio to the standard way is least over the scenes, if it is worth it in all; else None."""
    worth: dict[str, list[Way]] = {}
    for measured in scenes:
        for way in measured.ways:
            if way.ratio < LESS and way.us * (1 / way.ratio - 1) > LEAST_US:
                worth.setdefault(way.name, []).append(way)
    everywhere = [ways for ways in worth.values() if len(ways) == len(scenes)]
    return min(everywhere, key=lambda ways: max(way.ratio for way in ways))[0] if everywhere else None


@functools.cache
def build(kind: str) -> str:
    """The version, and a digest of the variants and their parameters: where it is another, measurements mean nothing."""
    return f"{__version__} ({hashlib.sha256(repr(native.REGISTRY[kind]).encode()).hexdigest()[:8]})"


def read(path: Path) -> File:
    """The file's content.

    Raises:
        OSError: it cannot be read.
        TuningError: it is not what ``write`` writes.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["format"] != FORMAT:
            raise TuningError(f"its format is {content['format']!r}, {FORMAT} expected")
        machines: dict[str, Any] = content["machines"]
        builds = {name: _typed(one["build"], str) for name, one in machines.items()}
        return File(builds, {name: [_measured(each) for each in one["measured"]] for name, one in machines.items()})
    except TuningError:
        raise
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise TuningError(f"it is no file of bigtri tune's ({type(error).__name__}: {error})") from None


def write(path: Path, file: File) -> None:
    """Replaces the file in one step, so that nobody reads half of it.

    Raises:
        OSError: it cannot be written.
    """
    machines = {
        name: {
            "build": file.builds[name],
            "measured": [each._asdict() | {"ways": [way._asdict() for way in each.ways]} for each in measured],
        }
        for name, measured in file.measured.items()
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    new = path.with_name(f"{path.name}.{os.getpid()}")
    new.write_text(json.dumps({"format": FORMAT, "machines": machines}, indent=1) + "\n", encoding="utf-8")
    new.replace(path)


def _measured(one: dict[str, Any]) -> Measured:
    texts = {name: _typed(one[name], str) for name in ("scene", "precision", "isa", "date")}
    numbers = {name: _typed(one[name], int) for name in ("width", "height", "views", "triangles", "threads")}
    return Measured(**texts, **numbers, ways=[_way(way) for way in one["ways"]])


def _way(one: dict[str, Any]) -> Way:
    parameters = {_typed(name, str): _typed(value, int) for name, value in one["parameters"].items()}
    us, ratio = (float(_typed(one[name], (float, int))) for name in ("us", "ratio"))
    if not (us > 0 and ratio > 0):
        raise ValueError("times must be above 0")
    return Way(_typed(one["variant"], str), parameters, us, ratio)


def _typed(value: Any, kind: type | tuple[type, ...]) -> Any:
    if not isinstance(value, kind) or isinstance(value, bool):
        raise TypeError(f"{value!r} is not of its type")
    return value
