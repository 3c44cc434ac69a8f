"""The private names of torch that bigtri uses, in one place: torch may rename them in any release.

Each has a fallback from public names, so that a torch without it still draws the same bits. All that a fallback may
lose is a good error text for a tensor that cannot be drawn. No other file of bigtri uses a name of torch that begins
with an underscore.
"""

from __future__ import annotations

import functools
import operator
from typing import Any

import torch

try:
    from torch._subclasses import FakeTensor
except ImportError:

    def is_fake(value: object) -> bool:
        """Whether a tensor has a shape and no data: one of torch.compile's, or made under a FakeTensorMode."""
        return type(value).__name__ == "FakeTensor"

else:

    def is_fake(value: object) -> bool:
        """Whether a tensor has a shape and no data: one of torch.compile's, or made under a FakeTensorMode."""
        return isinstance(value, FakeTensor)


def beside(constant: torch.Tensor, value: torch.Tensor) -> torch.Tensor:
    """``constant``, as a fake tensor where ``value`` is one: torch lets no operator have both kinds."""
    if not is_fake(value):
        return constant
    fake: Any = value
    return fake.fake_mode.from_tensor(constant)


def _never(value: torch.Tensor) -> bool:
    return False


def _has_storage(value: torch.Tensor) -> bool:
    try:
        value.untyped_storage()
    except (NotImplementedError, RuntimeError):
        return False
    return True


def _is_zero_tensor(value: torch.Tensor) -> bool:
    # Its storage has the bytes but no address. A storage that was freed has no bytes; a fake tensor must not be asked.
    if value.is_meta or is_fake(value) or not _has_storage(value):
        return False
    return value.numel() > 0 and value.untyped_storage().nbytes() > 0 and value.data_ptr() == 0


def _found(owner: Any, *names: str, otherwise: Any) -> Any:
    """The attribute that the names lead to from ``owner``, one after the other; ``otherwise`` where one is missing."""
    for name in names:
        try:
            owner = getattr(owner, name)
        except AttributeError:
            return otherwise
    return owner


# Whether a tensor is inside functionalization. Without the name it is taken, and torch says what it does not like.
is_functional = _found(torch, "_is_functional_tensor", otherwise=_never)

# Whether a tensor is inside torch.vmap. Without the name torch itself says that the operator has no rule for it.
is_batched = _found(torch, "_C", "_functorch", "is_batchedtensor", otherwise=_never)

# Whether a tensor has memory of its own. Inside torch.vmap and torch.func it has not.
has_storage = _found(torch, "_C", "_has_storage", otherwise=_has_storage)

# Whether a tensor stands for zeros that lie nowhere.
is_zero_tensor = _found(torch.Tensor, "_is_zerotensor", otherwise=_is_zero_tensor)


def _plain_keys() -> frozenset[int]:
    """The dispatch keys of an ordinary tensor on the CPU and on CUDA; none where torch has renamed what they are made of."""
    try:
        key, key_set = torch._C.DispatchKey, torch._C.DispatchKeySet
        keys = [(kind, f"Autograd{kind}", "ADInplaceOrView", f"Autocast{kind}") for kind in ("CPU", "CUDA")]
        return frozenset(functools.reduce(operator.or_, (key_set(getattr(key, k)) for k in each)).raw_repr() for each in keys)
    except AttributeError:
        return frozenset()


_PLAIN_KEYS = _plain_keys()
_dispatch_keys = _found(torch, "_C", "_dispatch_keys", otherwise=None)


def _is_plain(value: object) -> bool:
    return type(value) is torch.Tensor and _dispatch_keys(value).raw_repr() in _PLAIN_KEYS


# Whether a value is a tensor of torch's own class, dense, on the CPU or CUDA, whose memory reads as what it is: no view that
# negates, no zeros that lie nowhere, nothing inside torch.vmap, torch.func or functionalization. One question to torch instead
# of six. Without one of the names no tensor is known to be plain, and all six are asked.
is_plain = _is_plain if _dispatch_keys and _PLAIN_KEYS else _never


def keep_the_device_busy(cycles: int) -> None:
    """Let CUDA's current stream wait that long, so that a clock sees the device's time alone and not the host's.

    Without the name nothing waits, and short calls are timed with the host's time in them.
    """
    wait = getattr(torch.cuda, "_sleep", None)
    if wait is not None:
        wait(cycles)
