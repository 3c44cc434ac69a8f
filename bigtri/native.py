"""The extension: which of its libraries load, the instruction set in use, its variants and their parameters.

There are two libraries. ``bigtri._C`` defines the operators and draws on the CPU; ``bigtri._cuda`` adds the kernels for
CUDA and is optional, so that a CUDA runtime that is missing or wrong does not take the CPU away.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import NamedTuple

import torch

from . import fakes, warn
from .precision import DEFAULT

ISA_LEVELS = ("baseline", "avx2", "avx512")


class _Library(NamedTuple):
    there: bool  # whether its file lies in the package
    error: str  # why it did not load; empty if it did


def _load(name: str) -> _Library:
    there = importlib.util.find_spec(name) is not None
    try:
        importlib.import_module(name)
    except ImportError as error:
        return _Library(there, str(error) or repr(error))
    return _Library(there, "")


def _load_libraries() -> dict[str, _Library]:
    """The library that draws on each kind of device. Where the first does not load, the second is not tried."""
    cpu = _load("bigtri._C")
    return {"cpu": cpu, "cuda": cpu if cpu.error else _load("bigtri._cuda")}


_LIBRARIES = _load_libraries()


class Parameter(NamedTuple):
    """A number of a variant's that a caller may set; it changes no bit of the picture."""

    name: str
    unit: str  # of the number; empty for a plain one
    about: str
    standard: int
    low: int
    high: int
    only: tuple[int, ...]  # the values allowed; empty for all from low to high

    def allowed(self) -> str:
        """What values there are, for a text."""
        return ", ".join(map(str, self.only)) if self.only else f"{self.low} to {self.high}"


class Variant(NamedTuple):
    """A way to schedule the work, as the extension's registry has it."""

    name: str
    paper: str  # where the design is from
    parameters: dict[str, Parameter]


def _parsed(text: str) -> dict[str, Variant]:
    """What csrc/torch/registry.h wrote."""
    found: dict[str, Variant] = {}
    for line in text.splitlines():
        kind, *fields = line.split("\t")
        if kind == "variant":
            variant = Variant(name=fields[0], paper=fields[1], parameters={})
            found[variant.name] = variant
        else:
            name, unit, about, standard, low, high, only = fields
            values = tuple(map(int, only.split(","))) if only else ()
            variant.parameters[name] = Parameter(name, unit, about, int(standard), int(low), int(high), values)
    return found


def _registry() -> dict[str, dict[str, dict[str, Variant]]]:
    """Per kind of device and rung that is compiled for it, its variants by name, the one that "auto" means first."""
    found = {}
    if not _LIBRARIES["cpu"].error:
        found["cpu"] = {rung: _parsed(torch.ops.bigtri.variants(rung)) for rung in torch.ops.bigtri.rungs().split(", ")}
        if hasattr(torch.ops.bigtri, "cuda_variants"):  # the kernels for CUDA come with it
            rungs = torch.ops.bigtri.cuda_rungs().split(", ")
            found["cuda"] = {rung: _parsed(torch.ops.bigtri.cuda_variants(rung)) for rung in rungs}
    return found


REGISTRY = _registry()
# For each kind of device that the extension is built for ("cpu", "cuda"): how it can schedule the work with the default
# precision, the one that "auto" means first. All give the same bits.
VARIANTS: dict[str, tuple[str, ...]] = {kind: tuple(rungs[DEFAULT]) for kind, rungs in REGISTRY.items()}


class Counter(NamedTuple):
    """Something that variants count; csrc/core/counters.h."""

    depends: str  # "nothing", "spared", "order" or "most": what it depends on besides the scene and the parameters
    about: str  # what is counted


def _counters() -> dict[str, Counter]:
    """What csrc/torch/rasterize_ops.cpp wrote."""
    lines = (line.split("\t") for line in torch.ops.bigtri.counters().splitlines())
    return {name: Counter(depends.removeprefix("k").lower(), about) for name, depends, about in lines}


# What a variant counts where it is asked to, by name, in the order in which the operator writes the numbers.
COUNTERS: dict[str, Counter] = {} if _LIBRARIES["cpu"].error else _counters()


def available() -> bool:
    """Whether the extension is built and loads; for CUDA that is ``"cuda" in VARIANTS``."""
    return "cpu" in VARIANTS


def load_error(kind: str = "cpu") -> str:
    """Why the extension does not draw on a kind of device, "cpu" or "cuda"; empty if it does.

    A machine without a GPU is no such reason: the library for CUDA loads wherever there is a CUDA runtime.
    """
    return "" if kind in VARIANTS else _LIBRARIES[kind].error


def is_broken(kind: str = "cpu") -> bool:
    """Whether a library for this kind of device lies in the package, but does not load."""
    return kind not in VARIANTS and _LIBRARIES[kind].there


def warn_if_broken(kind: str) -> None:
    """A RuntimeWarning with the reason, once in the process, where ``is_broken(kind)``."""
    if is_broken(kind):
        without = {
            "cpu": "backend='auto' falls back to the NumPy reference: the same bits, 30 to 70 times slower",
            "cuda": "nothing is drawn from CUDA tensors, only from those on the CPU",
        }
        what = f"bigtri: the extension's library for {kind} is there but does not load, so {without[kind]}"
        warn.once(f"broken {kind}", f"{what}. {load_error(kind)}", RuntimeWarning)


def devices() -> list[str]:
    """The kinds of device that the extension draws on here: "cpu", and "cuda" if it is built for CUDA and there is one.

    Warns, once in the process, where there is one and the library for CUDA does not load. ``load_error("cuda")`` says why.
    """
    if available() and torch.cuda.is_available():
        warn_if_broken("cuda")
    return [kind for kind in VARIANTS if kind == "cpu" or torch.cuda.is_available()]


def counting_on_cuda() -> list[str]:
    """Variants that count their work on CUDA: those of ``exact``, if the extension was built with ``BIGTRI_CUDA_COUNTING=1``."""
    names = torch.ops.bigtri.cuda_counting() if "cuda" in VARIANTS else ""
    return names.split(", ") if names else []


def isa_levels() -> list[str]:
    """The instruction sets that this machine can run, slowest first; all give the same bits. Empty without the extension."""
    return [name for name in ISA_LEVELS if available() and torch.ops.bigtri.has_isa(name)]


def isa() -> str:
    """The instruction set in use: the best one, or what the environment variable BIGTRI_ISA or ``set_isa`` asked for."""
    return torch.ops.bigtri.isa()


def set_isa(name: str) -> None:
    """Run on another instruction set from now on, in the whole process.

    Raises:
        RuntimeError: this machine does not have it.
    """
    torch.ops.bigtri.set_isa(name)


@contextmanager
def using_isa(name: str) -> Iterator[None]:
    """``set_isa(name)`` for the length of a with block."""
    before = isa()
    set_isa(name)
    try:
        yield
    finally:
        set_isa(before)


_parameters: dict[str, int] = {}  # that using_parameters has set


@contextmanager
def using_parameters(**values: int) -> Iterator[None]:
    """Set parameters of variants for the length of a with block, in the whole process: for those variants that have them.

    Raises:
        RuntimeError: the extension is not built.
        TypeError: no variant has a parameter of that name.
        ValueError: no variant that has it allows the value.
    """
    if not REGISTRY:
        raise RuntimeError("bigtri.native.using_parameters: the extension is not built")
    for name, value in values.items():
        known = [v.parameters[name] for rungs in REGISTRY.values() for v in rungs[DEFAULT].values() if name in v.parameters]
        if not known:
            names = sorted({n for rungs in REGISTRY.values() for v in rungs[DEFAULT].values() for n in v.parameters})
            raise TypeError(f"bigtri.native.using_parameters: parameters are {', '.join(names)}, got {name}")
        if not any(_allows(parameter, value) for parameter in known):
            raise ValueError(f"bigtri.native.using_parameters: {name} must be {known[0].allowed()}, got {value!r}")
    before = dict(_parameters)
    _parameters.update(values)
    try:
        yield
    finally:
        _parameters.clear()
        _parameters.update(before)


def parameters_are_set() -> bool:
    """Whether a ``using_parameters`` is in force."""
    return bool(_parameters)


def _allows(parameter: Parameter, value: object) -> bool:
    if not isinstance(value, int) or isinstance(value, bool):
        return False
    return value in parameter.only if parameter.only else parameter.low <= value <= parameter.high


def parameter_values(op: str, variant: Variant, given: Mapping[str, int] | None) -> list[int]:
    """What an operator takes for ``parameters``: one value for each of the variant's, or none where all are standard.

    Raises:
        ValueError: the variant has no such parameter, or it does not allow the value.
    """
    if not given and not _parameters:
        return []
    given = given or {}
    for name, value in given.items():
        if name not in variant.parameters:
            names = ", ".join(variant.parameters) or "none"
            raise ValueError(f"bigtri.{op}: parameters of variant {variant.name!r} are {names}, got {name!r}")
        if not _allows(variant.parameters[name], value):
            allowed = variant.parameters[name].allowed()
            raise ValueError(f"bigtri.{op}: parameter {name} of variant {variant.name!r} must be {allowed}, got {value!r}")
    return [int(given.get(p.name, _parameters.get(p.name, p.standard))) for p in variant.parameters.values()]


if available():
    fakes.register()
if available() and (wanted := os.environ.get("BIGTRI_ISA")) and wanted not in isa_levels():
    raise ImportError(f"bigtri: BIGTRI_ISA must be one of {', '.join(isa_levels())} on this machine, got {wanted!r}")
