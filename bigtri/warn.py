"""Warnings that are said once in a process, at the line of the caller's own code that called for them."""

from __future__ import annotations

import inspect
import warnings

_said: set[str] = set()


def once(key: str, text: str, category: type[Warning]) -> None:
    """Warn with ``text``, unless there was a warning with this key before.

    Args:
        key: what the warning is about; calls that share it share the one warning, whatever their texts.
        text: names the function and the argument, and says what to do.
        category: for the filters of ``warnings``. Where they make errors of it, every call raises, as without a key.
    """
    if key not in _said:
        warnings.warn(text, category, stacklevel=_level_of_the_caller())
        _said.add(key)


def _level_of_the_caller() -> int:
    """The ``stacklevel`` that points out of the package, as seen from the function that calls this one."""
    frame, level = inspect.currentframe(), 0
    # By the module, because the methods that dataclasses writes are in no file.
    while frame is not None and frame.f_globals.get("__name__", "").partition(".")[0] == __package__:
        frame, level = frame.f_back, level + 1
    return level
