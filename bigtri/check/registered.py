"""Stages and variants of one's own, by name: what ``bigtri.verify`` compares with the reference; docs/validate.md.

They are kept in the process and never drawn by ``bigtri.rasterize``. A variant is what is registered under its name: some
stages, a function that draws the whole, or both.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import wraps
from typing import Any, TypeAlias, TypeVar

import numpy as np
import torch

from .. import native
from ..ops import arguments
from ..reference.records import Records

Stage: TypeAlias = Callable[..., Any]
StageT = TypeVar("StageT", bound=Stage)

_SCENE = ("positions", "triangles", "height", "width", "cull", "scissor")
# What each stage is called with, by position; "rasterize" is the whole.
ARGUMENTS: dict[str, tuple[str, ...]] = {
    "setup": _SCENE,
    "binning": ("records", "threshold"),
    "tile_mask": ("records", "queue"),
    "scanline": ("records", "queue", "touched", "small"),
    "depth": ("records", "spans"),
    "visibility": ("records", "spans", "depth", "height", "width"),
    "rasterize": _SCENE,
    "attributes": ("packed", "positions", "triangles"),
}

_variants: dict[str, dict[str, Stage]] = {}


def register_variant(name: str, *, device: str | torch.device | None = None) -> Callable[[StageT], StageT]:
    """A decorator: the function draws the variant ``name``, which ``verify.compare(..., variant=name)`` then compares.

    The function is called as ``draw(positions, triangles, height, width, cull, scissor)`` and returns ``(packed, dropped)``:
    int64 [H, W] as ``Visibility.packed``, and how many triangles are not finite. ``register_stage`` adds stages that the
    variant has as functions of their own, so that they are compared one by one.

    Args:
        name: of the variant. What was registered under it before, in a cell of a notebook say, is replaced.
        device: where to put the tensors that the function gets. None: it gets NumPy arrays. It may return either.

    Raises:
        TypeError, ValueError: a name that is no string, is empty or is one of the extension's; no such device; a function that
            does not take these arguments.
    """
    return _registers("register_variant", "rasterize", name, device)


def register_stage(stage: str, *, variant: str, device: str | torch.device | None = None) -> Callable[[StageT], StageT]:
    """A decorator: the function is this stage of the variant, which ``verify.compare(..., variant=variant)`` then compares.

    It takes the arguments of ``bigtri.reference.<stage>`` by position and returns the same. A variant without a function that
    draws it is drawn by its stages, with the reference's for those that it lacks.

    Args:
        stage: "setup", "binning", "tile_mask", "scanline", "depth", "visibility" or "attributes".
        variant: the name that ``verify.compare`` takes. There need be nothing under it yet.
        device: as for ``register_variant``.

    Raises:
        TypeError, ValueError: as for ``register_variant``, or no such stage.
    """
    arguments.check_choice("register_stage", "stage", stage, tuple(name for name in ARGUMENTS if name != "rasterize"))
    return _registers("register_stage", stage, variant, device)


def registered_variants() -> dict[str, tuple[str, ...]]:
    """The names under which something is registered, and the stages of each; "rasterize" is a function that draws the whole."""
    return {name: tuple(stage for stage in ARGUMENTS if stage in stages) for name, stages in _variants.items()}


def unregister_variant(name: str) -> None:
    """Forget the variant and its stages.

    Raises:
        ValueError: nothing is registered under this name.
    """
    if name not in _variants:
        known = ", ".join(map(repr, _variants)) or "none"
        raise ValueError(f"bigtri.unregister_variant: name must be a registered variant ({known}), got {name!r}")
    del _variants[name]


def stages_of(name: str) -> dict[str, Stage]:
    """The functions that are registered under the name, by stage; none where it is no registered variant."""
    return dict(_variants.get(name, {}))


def _registers(op: str, stage: str, variant: str, device: str | torch.device | None) -> Callable[[StageT], StageT]:
    argument = "name" if op == "register_variant" else "variant"
    if not isinstance(variant, str):
        raise TypeError(f"bigtri.{op}: {argument} must be a string, got {arguments.described(variant)}")
    taken = sorted({"auto", *(name for names in native.VARIANTS.values() for name in names)})
    if not variant or variant in taken:
        raise ValueError(f"bigtri.{op}: {argument} must be a name of your own, not {', '.join(taken)}, got {variant!r}")
    try:
        place = None if device is None else torch.device(device)
    except (RuntimeError, TypeError):
        raise ValueError(f"bigtri.{op}: device must be one of torch's or None, got {device!r}") from None

    def register(function: StageT) -> StageT:
        if not callable(function):
            raise TypeError(f"bigtri.{op}: {stage} must be callable, got {arguments.described(function)}")
        _check_signature(op, stage, function)
        _variants.setdefault(variant, {})[stage] = function if place is None else _on_tensors(function, place)
        return function

    return register


def _check_signature(op: str, stage: str, function: Stage) -> None:
    """Raise TypeError where the function cannot be called with the stage's arguments by position."""
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):  # some that are written in C have none
        return
    try:
        signature.bind(*ARGUMENTS[stage])
    except TypeError:
        wanted = f"{stage}({', '.join(ARGUMENTS[stage])})"
        name = getattr(function, "__name__", type(function).__name__)
        raise TypeError(f"bigtri.{op}: the function must take the arguments {wanted}, got {name}{signature}") from None


def _on_tensors(function: Stage, device: torch.device) -> Stage:
    """The function, which gets tensors on the device where it is called with arrays."""

    def tensor(value: Any) -> Any:
        if isinstance(value, Records):
            return Records(*map(tensor, value))
        return torch.from_numpy(value).to(device) if isinstance(value, np.ndarray) else value

    @wraps(function)
    def call(*given: Any) -> Any:
        return function(*map(tensor, given))

    return call
