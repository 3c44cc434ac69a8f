"""Calls of torch.ops.bigtri with all arguments in the schema's order: those that are keyword-only there are given by name."""

from __future__ import annotations

from typing import Any

import torch


def split(op: str, values: tuple[Any, ...]) -> tuple[tuple[Any, ...], dict[str, Any]]:
    """What of ``values`` goes by position and what by name."""
    arguments = getattr(torch.ops.bigtri, op).default._schema.arguments
    assert len(values) == len(arguments), (op, len(values), [a.name for a in arguments])
    pairs = list(zip(arguments, values, strict=True))
    return tuple(v for a, v in pairs if not a.kwarg_only), {a.name: v for a, v in pairs if a.kwarg_only}


def call(op: str, values: tuple[Any, ...]) -> Any:
    given, named = split(op, values)
    return getattr(torch.ops.bigtri, op)(*given, **named)
