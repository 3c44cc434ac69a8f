"""Memory for large results on the CPU: what an earlier result has let go is used again.

The system hands out new memory page by page and clears each page first. At 3840x2160 px that takes ten times as long as
drawing eight triangles. So the memory of a result is kept when the last tensor or array that refers to it is gone, and the
next result of about its size gets it. What is kept is bounded: ``limit`` says by how much, ``release`` empties it. New memory
asks for huge pages (NumPy's allocator does), which costs a quarter of ordinary ones; the threads that draw touch them first.

Nothing here is shared: a result has its memory alone for as long as anything refers to it.

The extension keeps working memory in the same way, from one call to the next: records of triangles and lists of bins, as much
as 128 MiB. ``working`` says how much there is, ``release`` empties it too.
"""

from __future__ import annotations

import operator
import os
import threading
import weakref
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from .. import native

SMALLEST = 1 << 20  # bytes: below that torch's own allocator is as fast
STANDARD_LIMIT = 512 << 20  # bytes
_ALIGNMENT = 64  # bytes: a cache line, which streaming stores want to begin on
_HUGE_PAGE = 2 << 20  # bytes
_SMALLEST_HUGE = 4 << 20  # bytes: from there on NumPy's allocator asks for huge pages

Buffer = NDArray[np.uint8]


class _Cache:
    """Buffers that no result uses, the one that was let go last at the end."""

    def __init__(self) -> None:
        self.free: list[Buffer] = []
        self.limit = STANDARD_LIMIT
        # take and give_back do not wait for it: a buffer may come back at any moment, from the garbage collector within a call
        # of this class too. Who does not get the lock does without the cache.
        self.lock = threading.Lock()

    def take(self, size: int) -> Buffer:
        """A buffer of at least ``size`` bytes: a free one that is not much larger, else a new one."""
        if self.lock.acquire(blocking=False):
            try:
                for k in range(len(self.free) - 1, -1, -1):
                    if size <= self.free[k].nbytes <= size + size // 4:
                        return self.free.pop(k)
            finally:
                self.lock.release()
        return np.empty(size, np.uint8)

    def give_back(self, buffer: Buffer) -> None:
        if self.lock.acquire(blocking=False):
            try:
                self.free.append(buffer)
                self.trim()
            finally:
                self.lock.release()

    def trim(self) -> None:
        while sum(buffer.nbytes for buffer in self.free) > self.limit:
            self.free.pop(0)


_cache = _Cache()


def _forget_the_lock() -> None:
    """In a forked child it may be held by a thread that is not there."""
    _cache.lock = threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_the_lock)


def is_torchs(like: torch.Tensor, shape: tuple[int, ...], dtype: torch.dtype) -> bool:
    """Whether ``new`` has the memory from torch's own allocator: all but large results on the CPU."""
    return not like.is_cpu or _bytes(shape, dtype) < SMALLEST


def new(like: torch.Tensor, shape: tuple[int, ...], dtype: torch.dtype) -> torch.Tensor:
    """A tensor whose content is not initialised, on the device of ``like``; beside a fake tensor a fake one."""
    if type(like) is not torch.Tensor or torch.compiler.is_compiling():
        return like.new_empty(shape, dtype=dtype)
    if is_torchs(like, shape, dtype):
        # Not new_empty(shape): torch takes 0.5 us of 1.5 to read a tuple there.
        return like.new_empty(*shape, dtype=dtype) if shape else like.new_empty_strided((), (), dtype=dtype)
    size = _bytes(shape, dtype)
    # Whole pages, so that the first and the last of a result are huge ones too.
    unit = _HUGE_PAGE if size >= _SMALLEST_HUGE else _ALIGNMENT
    buffer = _cache.take(-(-size // unit) * unit + unit)
    begin = -buffer.ctypes.data % unit
    result: Any = buffer[begin : begin + size]
    # The tensor holds `result`, and whatever views it the tensor's storage.
    weakref.finalize(result, _cache.give_back, buffer).atexit = False  # type: ignore[misc]
    return torch.from_numpy(result).view(dtype).view(shape)


def _bytes(shape: tuple[int, ...], dtype: torch.dtype) -> int:
    size = dtype.itemsize
    for n in shape:
        size *= n
    return size


def held() -> int:
    """Bytes that are kept for later results."""
    return sum(buffer.nbytes for buffer in list(_cache.free))


def limit(most: int | None = None) -> int:
    """How many bytes are kept at most; with an argument, set that first. The standard is 512 MiB.

    Raises:
        TypeError: ``most`` is no integer.
        ValueError: it is negative.
    """
    if most is not None:
        try:
            most = operator.index(most)
        except TypeError:
            raise TypeError(f"bigtri.memory.limit: most must be an integer of at least 0, got {most!r}") from None
        if most < 0:
            raise ValueError(f"bigtri.memory.limit: most must be an integer of at least 0, got {most}")
        with _cache.lock:
            _cache.limit = most
            _cache.trim()
    return _cache.limit


def working() -> int:
    """Bytes of working memory on the CPU that are kept for later calls, 128 MiB at most."""
    return int(torch.ops.bigtri.workspace_bytes()) if native.available() else 0


def release() -> None:
    """Give all memory that is kept for later results, and all working memory, back to the system."""
    with _cache.lock:
        _cache.free.clear()
    if native.available():
        torch.ops.bigtri.release_workspaces()
