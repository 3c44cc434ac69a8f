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


class Functional:
    """The operators that write to ``out``, with memory of their own for it on the first tensor's device."""

    @staticmethod
    def _returning(op: str, values: tuple[Any, ...], shape: tuple[int, ...], dtype: torch.dtype = torch.float32) -> torch.Tensor:
        out = torch.empty(shape, dtype=dtype, device=values[0].device)
        call(op, (*values, out))
        return out

    def interpolate(self, packed, positions, triangles, attributes, precision="exact"):
        values = packed, positions, triangles, attributes, precision
        return self._returning("interpolate", values, (*packed.shape, attributes.shape[2]))

    def barycentrics(self, packed, positions, triangles, precision="exact"):
        return self._returning("barycentrics", (packed, positions, triangles, precision), (*packed.shape, 3))

    def sample_texture(self, texture, uv, filter, wrap):
        return self._returning("sample_texture", (texture, uv, filter, wrap), (len(uv), texture.shape[2]))

    def lambert(self, normals, albedo, ambient, directions, colors):
        return self._returning("lambert", (normals, albedo, ambient, directions, colors), tuple(albedo.shape))

    def encode_srgb(self, linear, thresholds):
        return self._returning("encode_srgb", (linear, thresholds), tuple(linear.shape), torch.uint8)
