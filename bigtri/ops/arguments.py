"""NumPy or torch in, the same out: what the operations that read a visibility buffer share."""

from __future__ import annotations

import itertools
import operator
from collections.abc import Callable
from typing import Any, TypeAlias, TypeVar, overload

import numpy as np
import torch
from numpy.typing import NDArray

from .. import native, torch_private, warn
from ..choices import BACKENDS
from ..precision import PRECISIONS, RUNGS, Arithmetic, Precision, arithmetic_of
from ..reference.numerics import MAX_SIZE
from . import memory

Array: TypeAlias = "torch.Tensor | NDArray[Any]"
ArrayT = TypeVar("ArrayT", torch.Tensor, NDArray[Any])
_NUMPY_DTYPES = {
    **{torch.float32: np.dtype(np.float32), torch.uint8: np.dtype(np.uint8)},
    torch.uint16: np.dtype(np.uint16),
    **{torch.int32: np.dtype(np.int32), torch.int64: np.dtype(np.int64)},
}


def choose_backend(op: str, backend: str) -> str:
    """ "reference" or "native" for what the caller asked for; "auto" is native where the extension is built.

    Warns, once in the process, where "auto" is the reference because the extension is built but does not load.

    Raises:
        ValueError: an unknown name.
        RuntimeError: "native" without the extension.
    """
    check_choice(op, "backend", backend, BACKENDS)
    if backend == "auto":
        if native.available():
            return "native"
        if not torch.compiler.is_compiling():
            native.warn_if_broken("cpu")
        return "reference"
    if backend == "native" and not native.available():
        if native.is_broken():
            why = f"its library is there but does not load ({native.load_error()}): build it again"
        else:
            why = "build it"
        raise RuntimeError(
            f"bigtri.{op}: backend='native' needs the extension: {why} with `python setup.py build_ext --inplace`, "
            "or pass backend='reference'"
        )
    return backend


def check_choice(op: str, name: str, value: str, allowed: tuple[str, ...]) -> None:
    """Raise ValueError unless ``value`` is one of ``allowed``, TypeError if it is no string."""
    if not isinstance(value, str):
        raise TypeError(f"bigtri.{op}: {name} must be one of {', '.join(map(repr, allowed))}, got {described(value)}")
    if value not in allowed:
        raise ValueError(f"bigtri.{op}: {name} must be one of {', '.join(map(repr, allowed))}, got {value!r}")


def check_precision(op: str, precision: str | Precision) -> Arithmetic:
    """The arithmetic of a rung's name or of a ``Precision``.

    Raises:
        TypeError, ValueError: another type, or no rung's name.
    """
    if isinstance(precision, Precision):
        return arithmetic_of(precision)
    check_choice(op, "precision", precision, PRECISIONS)
    return RUNGS[precision]


def check_compiled(op: str, arithmetic: Arithmetic, kind: str) -> None:
    """Raise ValueError unless the extension has the arithmetic's rung for ``kind`` of device, "cpu" or "cuda"."""
    rungs = native.REGISTRY[kind]
    if arithmetic.name in rungs:
        return
    device = {"cpu": "the CPU", "cuda": "CUDA"}[kind]
    if arithmetic.name not in PRECISIONS:
        why = "a mix without a name is compiled for no device: pass backend='reference', or give it a name (CONTRIBUTING.md)"
    elif kind == "cpu":
        why = "build the extension with BIGTRI_LADDER=1, or pass backend='reference'"
    else:
        why = "it is compiled for the CPU alone"
    raise ValueError(
        f"bigtri.{op}: precision must be one of {', '.join(map(repr, rungs))} on {device}, got {arithmetic.name!r}; {why}"
    )


def check_flag(op: str, name: str, value: bool | None, optional: bool = False) -> None:
    """Raise TypeError unless ``value`` is True or False, or None where that is allowed."""
    if not isinstance(value, bool) and not (optional and value is None):
        allowed = "True, False or None" if optional else "True or False"
        raise TypeError(f"bigtri.{op}: {name} must be {allowed}, got {described(value)}")


def check_integers(op: str, name: str, value: object, count: int, wanted: str) -> tuple[int, ...]:
    """``value`` as ``count`` integers; ``wanted`` says for the error text what they are.

    Raises:
        TypeError: no iterable of integers.
        ValueError: another number of them.
    """
    try:
        # One more than wanted tells that there are too many, of an endless iterator too.
        numbers = tuple(operator.index(v) for v in itertools.islice(value, count + 1))  # type: ignore[call-overload]
    except TypeError:
        raise TypeError(f"bigtri.{op}: {name} must be {wanted}, integers, got {value!r}") from None
    if len(numbers) != count:
        raise ValueError(f"bigtri.{op}: {name} must be {wanted}, {count} integers, got {value!r}")
    return numbers


def check_tensor(
    op: str,
    name: str,
    value: Array,
    dtype: torch.dtype | tuple[torch.dtype, ...],
    shape: str,
    ndim: int | tuple[int, ...] | None,
    backend: str = "native",
) -> torch.Tensor:
    """``value`` as a contiguous tensor without a gradient; NumPy memory is shared, not copied.

    Warns, once in the process, of a tensor that requires grad where torch records gradients: none will come.

    Args:
        op, name, shape: for the error text; ``shape`` as a reader writes it, e.g. "[V, 3]".
        dtype: the one that is allowed, or several.
        ndim: how many dimensions are allowed; None: any number.
        backend: "reference" if NumPy is to read the memory, which is not there for every tensor that torch's operators take.

    Raises:
        TypeError: not an array, or of another dtype.
        ValueError: another number of dimensions, or no memory.
    """
    allowed = dtype if isinstance(dtype, tuple) else (dtype,)
    if isinstance(value, np.ndarray):
        # Converting an unsupported NumPy dtype would raise torch's error, which does not name the argument.
        if not any(value.dtype == np.dtype(_short(one)) for one in allowed):
            raise TypeError(f"bigtri.{op}: {name} must be {_short(dtype)} {shape}, got {described(value)}")
        value = np.asarray(value, order="C")
        value = _over(value if value.flags.writeable else value.copy())
    check_dense(op, name, value, dtype, shape)
    if value.dtype not in allowed:
        raise TypeError(f"bigtri.{op}: {name} must be {_short(dtype)} {shape}, got {described(value)}")
    if ndim is not None and value.ndim not in ((ndim,) if isinstance(ndim, int) else ndim):
        raise ValueError(f"bigtri.{op}: {name} must be {_short(dtype)} {shape}, got {described(value)}")
    if not torch.compiler.is_compiling():  # under torch.compile there is no memory to look at; the operators look when they run
        if value.is_cuda and backend == "native":
            native.warn_if_broken("cuda")
        if torch_private.is_zero_tensor(value) or value.is_neg():
            value = value.clone().resolve_neg()
        if backend == "reference":
            check_readable(op, name, value)
        check_memory(op, name, value)
    if value.requires_grad:
        if torch.is_grad_enabled() and not torch.compiler.is_compiling():
            what = f"bigtri.{op}: {name} requires grad, but nothing in bigtri is differentiable yet and no gradient reaches it"
            warn.once("grad", f"{what}; pass {name}.detach(), or call it under torch.no_grad()", UserWarning)
        value = value.detach()
    return value.contiguous()


def as_is(value: Array, dtype: torch.dtype) -> torch.Tensor | None:
    """What ``check_tensor`` would return without a copy or a warning; None where it has to look closer.

    Shapes, devices and whether there is memory for all elements are not looked at: the operators check those.
    """
    if isinstance(value, np.ndarray):
        flags = value.flags
        return _over(value) if value.dtype == _NUMPY_DTYPES[dtype] and flags.c_contiguous and flags.writeable else None
    if torch_private.is_plain(value) and value.dtype is dtype and value.is_contiguous() and not value.requires_grad:
        return value
    return None


def for_operator(value: Array, dtype: torch.dtype) -> torch.Tensor | None:
    """What ``as_is`` returns, for an argument that an operator only reads, in half the time where it is a tensor.

    dtype and device are left to the operator, and a view that negates to torch, which hands a copy on. Wrapped tensors have no
    address, nor have those without elements, which ``as_is`` looks at.

    Raises:
        RuntimeError: a tensor that cannot have an address: inside torch.vmap or torch.func, or sparse.
    """
    if type(value) is not torch.Tensor or not value.data_ptr():
        return as_is(value, dtype)
    return value if value.is_contiguous() and not value.requires_grad else None


def all_as_is(*given: tuple[Array, torch.dtype]) -> list[torch.Tensor]:
    """``as_is`` of every value with its dtype; empty where it is None for one, and under torch.compile."""
    tensors: list[torch.Tensor] = []
    if torch.compiler.is_compiling():
        return tensors
    for value, dtype in given:
        tensor = as_is(value, dtype)
        if tensor is None:
            return []
        tensors.append(tensor)
    return tensors


def run_as_is(
    operator: Callable[..., None], inputs: tuple[Any, ...], out: Array | None, dtype: torch.dtype, shape: tuple[int, ...]
) -> torch.Tensor | None:
    """Call an operator whose last argument is the result, ``out`` or new memory; ``inputs`` begin with a tensor of ``as_is``.

    None, and nothing is written, where the operator refuses one of its arguments. It checks what the functions here check
    of dense tensors, and first of all. Only its texts are others, so they are not shown: the caller goes on to the checks.
    """
    try:
        result = memory.new(inputs[0], shape, dtype) if out is None else as_is(out, dtype)
        if result is None:
            return None
        operator(*inputs, result)
    except (RuntimeError, MemoryError):
        return None
    return result


def check_dense(op: str, name: str, value: object, dtype: torch.dtype | tuple[torch.dtype, ...], shape: object) -> None:
    """Raise TypeError unless ``value`` is a tensor, ValueError if it is sparse or nested; dtype and shape are for the text."""
    if not isinstance(value, torch.Tensor):
        wanted = f"a torch tensor or a NumPy array, {_short(dtype)} {shape}"
        raise TypeError(f"bigtri.{op}: {name} must be {wanted}, got {type(value).__name__}")
    if value.is_nested or value.layout != torch.strided:
        came = "a nested tensor" if value.is_nested else value.layout
        raise ValueError(f"bigtri.{op}: {name} must be a dense tensor, {_short(dtype)} {shape}, got {came}")


def check_memory(op: str, name: str, value: torch.Tensor) -> None:
    """Raise ValueError where the storage of a dense tensor has been freed or made smaller than what the tensor reads."""
    try:
        available = value.untyped_storage().nbytes()
    except NotImplementedError:  # inside torch.vmap or torch.func: the operators get a tensor with memory
        return
    end = value.numel()
    if not value.is_contiguous() and end:
        end = 1 + sum((n - 1) * stride for n, stride in zip(value.shape, value.stride(), strict=True))
    needed = (value.storage_offset() + end) * value.element_size()
    if end and needed > available:
        raise ValueError(
            f"bigtri.{op}: {name} must have memory for all its elements, {needed} bytes, got a storage of {available} bytes"
        )


def check_writable_along(op: str, name: str, value: torch.Tensor) -> None:
    """Raise ValueError where torch cannot run an operator on ``value`` that writes into another tensor."""
    if torch_private.is_functional(value) or torch_private.is_batched(value):
        raise ValueError(f"bigtri.{op}: {name} must be a plain tensor, got one inside torch.vmap or functionalization")


def check_own_memory(op: str, name: str, value: torch.Tensor) -> None:
    """Raise ValueError for a tensor without memory of its own: inside torch.vmap, torch.func or functionalization."""
    if torch_private.is_functional(value) or not torch_private.has_storage(value):
        raise ValueError(
            f"bigtri.{op}: {name} must be a plain tensor, got one inside torch.vmap, torch.func or functionalization"
        )


def check_readable(op: str, name: str, value: torch.Tensor) -> None:
    """Raise ValueError unless NumPy can read the tensor, where it is or from a copy."""
    check_own_memory(op, name, value)
    # The address of a fake tensor is deprecated; that of a subclass around other tensors is 0. Meta tensors are same_device's.
    if torch_private.is_fake(value) or (
        value.numel() and not (value.is_meta or value.data_ptr()) and value.untyped_storage().nbytes()
    ):
        raise ValueError(f"bigtri.{op}: {name} must be a tensor with data, got {type(value).__name__}")


def check_size(op: str, name: str, value: torch.Tensor, dim: int, allowed: int, why: str) -> None:
    """Raise ValueError unless dimension ``dim`` of ``value`` is ``allowed``; ``why`` completes the sentence."""
    if not value.ndim or value.shape[dim] != allowed:
        raise ValueError(f"bigtri.{op}: {name} must have size {allowed} in dimension {dim} ({why}), got {list(value.shape)}")


def check_image_size(op: str, name: str, value: object) -> tuple[int, int]:
    """``value`` as (height, width) of an image.

    Raises:
        TypeError: no pair of integers.
        ValueError: another number of them, or a size that is not 1 to 16384.
    """
    if type(value) is tuple and len(value) == 2 and type(value[0]) is int and type(value[1]) is int:
        height, width = value  # as nearly every caller has it
    else:
        height, width = check_integers(op, name, value, 2, "(height, width)")
    if not (1 <= height <= MAX_SIZE and 1 <= width <= MAX_SIZE):
        raise ValueError(f"bigtri.{op}: {name} must be (height, width), 1 to {MAX_SIZE} each, got {(height, width)}")
    return height, width


def check_scissor(op: str, scissor: object | None, height: int, width: int) -> tuple[int, int, int, int]:
    """(x0, y0, x1, y1) of the part of the image that a scissor leaves, all of it for None.

    Raises:
        TypeError: no integers.
        ValueError: another number of them, or a box that ends before it begins.
    """
    if scissor is None:
        return 0, 0, width, height
    x0, y0, x1, y1 = check_integers(op, "scissor", scissor, 4, "(x0, y0, x1, y1)")
    if not (x0 <= x1 and y0 <= y1):
        raise ValueError(f"bigtri.{op}: scissor must be (x0, y0, x1, y1) with x0 <= x1 and y0 <= y1, got {(x0, y0, x1, y1)}")
    # Cut here, because the operators take no integer beyond 64 bits.
    return min(max(x0, 0), width), min(max(y0, 0), height), min(max(x1, 0), width), min(max(y1, 0), height)


def check_same_device(op: str, backend: str, **arguments: torch.Tensor) -> None:
    """Raise ValueError unless all are on the first one's device, and there is data there if the reference is to read it."""
    (first, reference), *others = arguments.items()
    for name, value in others:
        if value.device != reference.device:
            raise ValueError(f"bigtri.{op}: {name} must be on {first}'s device, {reference.device}, got {value.device}")
    if backend == "reference" and reference.is_meta:
        raise ValueError(f"bigtri.{op}: {first} must be a tensor with data, got one on {reference.device}")


def check_apart(op: str, output_name: str, output: torch.Tensor, **inputs: torch.Tensor) -> None:
    """Raise ValueError where an output shares memory with an input, all contiguous; not where there is no memory to look at."""
    if torch_private.is_fake(output):
        return
    begin, end = _extent(output)
    for name, value in inputs.items():
        first, last = _extent(value)
        if begin < last and first < end:
            raise ValueError(f"bigtri.{op}: {output_name} must not share memory with {name}")


def check_output(
    op: str,
    out: Array | None,
    dtype: torch.dtype,
    shape: tuple[int, ...],
    device: torch.device,
    apart: dict[str, torch.Tensor],
    argument: str = "out",
) -> torch.Tensor:
    """New memory for a result, or the caller's ``out``.

    Args:
        op, argument: for the error text.
        dtype, shape, device: of the result.
        apart: what ``out`` must not share memory with, by name, an input first.

    Raises:
        TypeError, ValueError: ``out`` is of another dtype, shape or device, or shares memory; the text names it.
    """

    def wrong(error: type[Exception], also: str = "") -> Exception:
        wanted = f"{_short(dtype)} {list(shape)}, contiguous, on {device}"
        return error(f"bigtri.{op}: {argument} must be {wanted}, got {described(out)}{also}")

    if not torch.compiler.is_compiling():
        for name, value in apart.items():
            check_writable_along(op, name, value)
    if out is None:
        return memory.new(next(iter(apart.values())), shape, dtype)
    # A NumPy array is looked at as it is: torch takes no other byte order and no negative strides.
    if isinstance(out, np.ndarray):
        if not out.flags.writeable:
            raise ValueError(f"bigtri.{op}: {argument} must be writable, got a read-only NumPy array")
        is_wanted, is_contiguous = out.dtype == np.dtype(_short(dtype)), out.flags.c_contiguous
    else:
        check_dense(op, argument, out, dtype, list(shape))
        is_wanted, is_contiguous = out.dtype == dtype, out.is_contiguous()
    if not is_wanted:
        raise wrong(TypeError)
    if out.shape != shape:
        raise wrong(ValueError)
    if not is_contiguous:
        raise wrong(ValueError, f" with strides {out.strides if isinstance(out, np.ndarray) else out.stride()}")
    tensor = _over(out) if isinstance(out, np.ndarray) else out
    if tensor.device != device:
        raise wrong(ValueError, f" on {tensor.device}")
    if not torch.compiler.is_compiling():
        check_own_memory(op, argument, tensor)
        if tensor.is_neg() or torch_private.is_zero_tensor(tensor):
            raise wrong(ValueError, ", a negated view" if tensor.is_neg() else ", a zero tensor without memory")
        check_memory(op, argument, tensor)
        check_apart(op, argument, tensor, **apart)
    return tensor


def on_reference(function: Callable[..., NDArray[Any]], *arguments: Any) -> torch.Tensor:
    """Call a NumPy function on tensors (other arguments pass through); the result is on the first tensor's device."""
    device = next(a.device for a in arguments if isinstance(a, torch.Tensor))
    result = function(*(a.cpu().numpy() if isinstance(a, torch.Tensor) else a for a in arguments))
    return torch.from_numpy(np.asarray(result, order="C")).to(device)  # not ascontiguousarray, which makes [1] of []


@overload
def like(result: torch.Tensor, given: torch.Tensor) -> torch.Tensor: ...
@overload
def like(result: torch.Tensor, given: NDArray[Any]) -> NDArray[Any]: ...
@overload
def like(result: torch.Tensor, given: Array) -> Array: ...
def like(result: torch.Tensor, given: Array) -> Array:
    """``result`` as NumPy if ``given`` is NumPy."""
    return result.numpy() if isinstance(given, np.ndarray) else result


def _over(array: NDArray[Any]) -> torch.Tensor:
    """A tensor over the memory of an array that is C-contiguous and writable."""
    try:
        return torch.from_numpy(array)
    except ValueError:  # a dimension of size 1 may have any stride in NumPy, and torch takes no negative one
        return torch.from_numpy(array.reshape(-1)).view(array.shape)


def _extent(value: torch.Tensor) -> tuple[int, int]:
    """Where a contiguous tensor's memory begins and ends."""
    begin = value.data_ptr()
    return begin, begin + value.nbytes


def described(value: object) -> str:
    """What came, for an error text."""
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {list(value.shape)}"
    if isinstance(value, torch.Tensor):
        return f"{_short(value.dtype)} {list(value.shape)}"
    return repr(value) if value is None or isinstance(value, (int, float, str)) else type(value).__name__


def _short(dtype: torch.dtype | tuple[torch.dtype, ...]) -> str:
    if isinstance(dtype, tuple):
        *others, last = map(_short, dtype)
        return f"{', '.join(others)} or {last}"
    return str(dtype).removeprefix("torch.")
