"""Tables of measurements for the documentation, which keep to their place between markers."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Numbers to the right, the first column to the left."""
    lines = [head, ["---", *["--:"] * (len(head) - 1)], *rows]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines)


def wrapped(paragraph: str) -> str:
    """A paragraph in lines of 120, as pages have it."""
    return textwrap.fill(paragraph, 120, break_long_words=False, break_on_hyphens=False)


def paste(path: Path, name: str, text: str) -> None:
    """Replaces what a page has between ``<!-- name: begin -->`` and ``<!-- name: end -->``.

    Raises:
        ValueError: the page lacks a marker.
    """
    page = path.read_text()
    begin, end = (f"<!-- {name}: {which} -->" for which in ("begin", "end"))
    before, found, rest = page.partition(begin)
    _, also_found, after = rest.partition(end)
    if not (found and also_found):
        raise ValueError(f"{path}: no {begin} and {end}")
    path.write_text(f"{before}{begin}\n{text}\n{end}{after}")
