"""The floating-point mode that the reference computes in, whatever the caller's thread was set to; docs/numerics.md section 1.

A thread that flushes denormals to zero (torch.set_flush_denormal, or a library built with -ffast-math) or that rounds in another
direction would get other bits. ``bigtri/csrc/cpu/parallel.h`` does the same for the extension.
"""

from __future__ import annotations

import ctypes
import platform
import sys
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

_P = ParamSpec("_P")
_T = TypeVar("_T")

_Environment = ctypes.c_uint64 * 8  # C's fenv_t has 32 bytes on x86-64, 8 on AArch64
_DEFAULT = ctypes.c_void_p(-1)  # FE_DFL_ENV: to nearest, denormals kept, no traps; glibc and musl define it like this
_IS_KNOWN = sys.platform == "linux" and platform.machine() in ("x86_64", "aarch64")


def default_float_mode(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """``function``, run in the default floating-point mode; the caller's mode is put back at the end, after an error too.

    For Linux on x86-64 and AArch64. Elsewhere ``function`` runs in the caller's mode, which must be the default one.
    """
    if not _IS_KNOWN:
        return function
    get, put = _functions()

    @wraps(function)
    def in_default_mode(*args: _P.args, **kwargs: _P.kwargs) -> _T:
        callers = _Environment()
        get(callers)
        put(_DEFAULT)
        try:
            return function(*args, **kwargs)
        finally:
            put(callers)

    return in_default_mode


def _functions() -> tuple[Callable[..., int], Callable[..., int]]:
    """C's fegetenv and fesetenv, called in the thread that asks. PyDLL keeps the interpreter's lock: they take nanoseconds."""
    try:
        library = ctypes.PyDLL("libm.so.6")
    except OSError:  # musl has them in libc
        library = ctypes.PyDLL(None)
    functions = library.fegetenv, library.fesetenv
    for function in functions:
        function.argtypes = [ctypes.c_void_p]
    return functions
