"""What every run of the tests tries, and what only a run of all of them does: ``pytest --all``, ``make test-all``."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import pytest

exhaustive = pytest.mark.exhaustive  # a test, or a parameter's value, that is left out of every other run


def some_of(few: Iterable, everything: Sequence) -> list:
    """Parameters for ``pytest.mark.parametrize``: all of ``everything``; those that are not among ``few`` by ``--all`` alone.

    Raises:
        ValueError: one of the few is none of everything.
    """
    chosen = list(few)
    if unknown := [value for value in chosen if value not in everything]:
        raise ValueError(f"few must be among everything, got {unknown} too")
    return [value if value in chosen else pytest.param(value, marks=exhaustive) for value in everything]
