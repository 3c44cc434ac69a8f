"""NumPy or torch in, the same out: what the operations that read a visibility buffer share."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias, TypeVar, overload

import numpy as np
import torch
from numpy.typing import NDArray

from . import native

Array: TypeAlias = "torch.Tensor | NDArray[Any]"
ArrayT = TypeVar("ArrayT", torch.Tensor, NDArray[Any])
BACKENDS = ("auto", "reference", "native")


def choose_backend(op: str, backend: str) -> str:
    """ "reference" or "native" for what the caller asked for; "auto" is native where the extension is built.

    Raises:
        ValueError: an unknown name.
        RuntimeError: "native" without the extension.
    """
    choice(op, "backend", backend, BACKENDS)
    if backend == "auto":
        return "native" if native.available() else "reference"
    if backend == "native" and not native.available():
        raise RuntimeError(
            f"bigtri.{op}: backend='native' needs the extension: build it with `python setup.py build_ext --inplace`, "
            "or pass backend='reference'"
        )
    return backend


def choice(op: str, name: str, value: str, allowed: tuple[str, ...]) -> None:
    """Raise ValueError unless ``value`` is one of ``allowed``."""
    if value not in allowed:
        raise ValueError(f"bigtri.{op}: {name} must be one of {', '.join(map(repr, allowed))}, got {value!r}")


def tensor(op: str, name: str, value: Array, dtype: torch.dtype, shape: str, ndim: int | tuple[int, ...]) -> torch.Tensor:
    """``value`` as a contiguous tensor without a gradient; NumPy memory is shared, not copied.

    Args:
        op, name, shape: for the error text; ``shape`` as a reader writes it, e.g. "[V, 3]".
        dtype: the one that is allowed.
        ndim: how many dimensions are allowed.

    Raises:
        TypeError: not an array, or of another dtype.
        ValueError: another number of dimensions.
    """
    wanted = f"{_short(dtype)} {shape}"
    if isinstance(value, np.ndarray):
        # Converting an unsupported NumPy dtype would raise torch's error, which does not name the argument.
        if value.dtype != np.dtype(_short(dtype)):
            raise TypeError(f"bigtri.{op}: {name} must be {wanted}, got {value.dtype} {list(value.shape)}")
        value = np.ascontiguousarray(value) if value.ndim else value
        value = torch.from_numpy(value if value.flags.writeable else value.copy())
    if not isinstance(value, torch.Tensor):
        raise TypeError(f"bigtri.{op}: {name} must be a torch tensor or a NumPy array, {wanted}, got {type(value).__name__}")
    if value.dtype != dtype:
        raise TypeError(f"bigtri.{op}: {name} must be {wanted}, got {_short(value.dtype)} {list(value.shape)}")
    if value.layout != torch.strided:
        raise ValueError(f"bigtri.{op}: {name} must be a dense tensor, {wanted}, got {value.layout}")
    if value.ndim not in ((ndim,) if isinstance(ndim, int) else ndim):
        raise ValueError(f"bigtri.{op}: {name} must be {wanted}, got {_short(dtype)} {list(value.shape)}")
    return value.detach().contiguous()


def size(op: str, name: str, value: torch.Tensor, dim: int, allowed: int, why: str) -> None:
    """Raise ValueError unless dimension ``dim`` of ``value`` is ``allowed``; ``why`` completes the sentence."""
    if value.shape[dim] != allowed:
        raise ValueError(f"bigtri.{op}: {name} must have size {allowed} in dimension {dim} ({why}), got {list(value.shape)}")


def same_device(op: str, **arguments: torch.Tensor) -> None:
    """Raise ValueError unless all are on the first one's device."""
    (first, reference), *others = arguments.items()
    for name, value in others:
        if value.device != reference.device:
            raise ValueError(f"bigtri.{op}: {name} must be on {first}'s device, {reference.device}, got {value.device}")


def apart(op: str, output_name: str, output: torch.Tensor, **inputs: torch.Tensor) -> None:
    """Raise RuntimeError where an output shares memory with an input, all contiguous; the extension checks by itself."""
    begin, end = _extent(output)
    for name, value in inputs.items():
        first, last = _extent(value)
        if begin < last and first < end:
            raise RuntimeError(f"bigtri.{op}: {output_name} must not share memory with {name}")


def on_reference(function: Callable[..., NDArray[Any]], *arguments: Any) -> torch.Tensor:
    """Call a NumPy function on tensors (other arguments pass through); the result is on the first tensor's device."""
    device = next(a.device for a in arguments if isinstance(a, torch.Tensor))
    result = function(*(a.cpu().numpy() if isinstance(a, torch.Tensor) else a for a in arguments))
    return torch.from_numpy(np.ascontiguousarray(result)).to(device)


@overload
def like(result: torch.Tensor, given: torch.Tensor) -> torch.Tensor: ...
@overload
def like(result: torch.Tensor, given: NDArray[Any]) -> NDArray[Any]: ...
@overload
def like(result: torch.Tensor, given: Array) -> Array: ...
def like(result: torch.Tensor, given: Array) -> Array:
    """``result`` as NumPy if ``given`` is NumPy."""
    return result.numpy() if isinstance(given, np.ndarray) else result


def _extent(value: torch.Tensor) -> tuple[int, int]:
    """Where a contiguous tensor's memory begins and ends."""
    return value.data_ptr(), value.data_ptr() + value.numel() * value.element_size()


def _short(dtype: torch.dtype) -> str:
    return str(dtype).removeprefix("torch.")
