"""What every operator asks of its tensors and what it returns, without memory: for torch.compile, FakeTensorMode and opcheck.

torch runs a fake kernel wherever one argument is on the meta device, so the real operator's checks do not see such a call: the
number of dimensions and the device are checked here too.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import torch

Result = Callable[[dict[str, Any]], Any]


class _Operator(NamedTuple):
    # Of each tensor, in the schema's order: a number or several allowed ones; a name: as that one; None: any number.
    dimensions: dict[str, int | tuple[int, ...] | str | None]
    result: Result = lambda _: None  # operators that write to an argument return nothing
    anywhere: tuple[str, ...] = ()  # tensors that may also be on the CPU, wherever the others are


def _new_size() -> torch.SymInt:
    """A number of rows that only the data decides."""
    return torch.library.get_ctx().new_dynamic_size(min=0)


def _visibility(a: dict[str, Any]) -> tuple[torch.Tensor | None, ...]:
    positions, views = a["positions"], a["positions"].shape[:-2]
    image = (*views, a["height"], a["width"])
    depth = positions.new_empty(image) if a["depth"] else None
    return positions.new_empty(image, dtype=torch.int64), depth, positions.new_empty(views, dtype=torch.int64)


def _records(a: dict[str, Any]) -> tuple[torch.Tensor, ...]:
    n = _new_size()
    i32, f32, i64, f64 = torch.int32, torch.float32, torch.int64, torch.float64
    shapes = [((n,), i32), ((n, 3, 2), i32), ((n, 3), f32), ((n,), i64), ((n, 4), i32), ((n, 3), f64), ((n, 3), i32)]
    shapes += [((n, 3, 3), f64), ((n,), torch.bool), ((), i64)]
    return tuple(a["positions"].new_empty(shape, dtype=dtype) for shape, dtype in shapes)


def _bins(a: dict[str, Any]) -> tuple[torch.Tensor, ...]:
    xy, candidates, small = a["xy"], _new_size(), _new_size()
    return xy.new_empty((candidates, 3)), xy.new_empty((candidates,), dtype=torch.bool), xy.new_empty((small,))


def _masks(a: dict[str, Any]) -> tuple[torch.Tensor, ...]:
    masks = a["queue"].new_empty((a["queue"].shape[0],), dtype=torch.int64)
    return masks, torch.empty_like(masks)


_READ: dict[str, int | tuple[int, ...] | str | None] = {"packed": (2, 3), "positions": "packed", "triangles": 2}
# What a picture is made of, and it.
_PICTURE: dict[str, int | tuple[int, ...] | str | None] = {
    **{"positions": 3, "triangles": 2, "uvs": 2, "colors": 2, "normals": 2, "face_normals": 2, "material": 1, "looks": 2},
    **{"base_colors": 2, "light_directions": 2, "light_colors": 2, "constants": 2, "thresholds": 1},
    **{"image": 4, "albedo": 4, "normal_image": 4, "linear": 4},
}
OPERATORS: dict[str, _Operator] = {
    "rasterize": _Operator(
        {
            "positions": (2, 3),
            "triangles": 2,
            "ranges": 2,
            "packed": (2, 3),
            "behind": "packed",
            "depth": "packed",
            "dropped": (0, 1),
            "counters": 1,
        },
        anywhere=("ranges",),
    ),
    "map_work": _Operator(
        {
            **{"positions": 2, "triangles": 2, "packed": 2, "dropped": 0},
            **{"counters": 1, "fragments": 2, "edges": 1, "tasks": 1},
        }
    ),
    "rasterize_new": _Operator({"positions": (2, 3), "triangles": 2}, _visibility),
    "rasterize_into": _Operator(
        {"positions": (2, 3), "triangles": 2, "packed": "positions", "depth": "positions"},
        lambda a: a["positions"].new_empty(a["positions"].shape[:-2], dtype=torch.int64),
    ),
    "setup": _Operator({"positions": 2, "triangles": 2}, _records),
    "binning": _Operator({"xy": 3, "bbox": 2}, _bins),
    "tile_mask": _Operator({"xy": 3, "bbox": 2, "queue": 2}, _masks),
    "scanline": _Operator(
        {"xy": 3, "bbox": 2, "queue": 2, "touched": 1, "small": 1}, lambda a: a["xy"].new_empty((_new_size(), 4))
    ),
    "depth": _Operator({"xy": 3, "z": 2, "area": 1, "spans": 2}, lambda a: a["z"].new_empty((_new_size(),))),
    "visibility": _Operator({"triangle": 1, "spans": 2, "depth": 1, "out": 2}),
    "interpolate": _Operator({**_READ, "attributes": (2, 3), "out": (3, 4)}),
    "barycentrics": _Operator({**_READ, "out": (3, 4)}),
    "sample_texture": _Operator({"texture": 3, "uv": None, "out": "uv"}),
    "lambert": _Operator(
        {
            **{"normals": None, "albedo": "normals", "ambient": 1, "light_directions": 2, "light_colors": 2},
            "out": "normals",
        }
    ),
    "encode_srgb": _Operator({"linear": None, "thresholds": 1, "out": "linear"}, anywhere=("thresholds",)),
    "transform": _Operator({"points": 2, "matrices": 3, "out": 3}),
    "shade": _Operator({"packed": 3, **_PICTURE}, anywhere=("constants", "thresholds")),
    "draw": _Operator({**_PICTURE, "packed": 3, "depth": 3, "dropped": 1}, anywhere=("constants", "thresholds")),
}


def _fake(name: str, defaults: dict[str, Any], *given: Any, **named: Any) -> Any:
    """The fake kernel of an operator; ``defaults``: of its arguments, in the schema's order, None where there is none.

    Raises:
        RuntimeError: a tensor has another number of dimensions, or is not on the first one's device.
    """
    operator = OPERATORS[name]
    bound = defaults | dict(zip(defaults, given, strict=False)) | named
    tensors = {key: bound[key] for key in operator.dimensions if bound.get(key) is not None}
    first, reference = next(iter(tensors.items()))
    for key, value in tensors.items():
        wanted = operator.dimensions[key]
        wanted = tensors[wanted].ndim if isinstance(wanted, str) else wanted
        allowed = (wanted,) if isinstance(wanted, int) else wanted
        if allowed is not None and value.ndim not in allowed:
            wanted = " or ".join(map(str, allowed))
            raise RuntimeError(f"bigtri::{name}: {key} must have {wanted} dimensions, got {list(value.shape)}")
        if value.device != reference.device and not (key in operator.anywhere and value.device.type == "cpu"):
            raise RuntimeError(f"bigtri::{name}: {key} must be on {reference.device} like {first}, got {value.device}")
    return operator.result(bound)


def register() -> None:
    """Make them known to torch; the library with the schemas has to be loaded.

    Raises:
        ImportError: that library lacks some of them, so it was built from other sources than lie here.
    """
    if lacking := [name for name in OPERATORS if not hasattr(torch.ops.bigtri, name)]:
        raise ImportError(
            f"bigtri: the extension lacks the operators {', '.join(lacking)}: it was built from other sources than lie here; "
            "build it again with `python setup.py build_ext --inplace`"
        )
    for name in OPERATORS:
        arguments = getattr(torch.ops.bigtri, name).default._schema.arguments
        defaults = {argument.name: argument.default_value for argument in arguments}
        torch.library.register_fake(f"bigtri::{name}")(partial(_fake, name, defaults))
