"""How much work a variant does for a picture, counted by the extension or worked out by the reference."""

from __future__ import annotations

import torch

from .. import native, reference
from ..choices import CULLS
from ..ops import arguments
from ..ops.arguments import Array
from ..ops.rasterize import check_indices
from ..precision import DEFAULT, Precision
from ..reference.variants import COUNTS

Scissor = tuple[int, int, int, int]


def count(
    positions: Array,
    triangles: Array,
    resolution: tuple[int, int],
    *,
    variant: str,
    backend: str = "auto",
    precision: str | Precision = DEFAULT,
    cull: str = "none",
    scissor: Scissor | None = None,
) -> dict[str, int]:
    """The counters of csrc/core/counters.h that are not 0, by name; the same on both backends.

    Args:
        positions, triangles, resolution, cull, scissor, precision: as for ``rasterize``; on the CPU.
        variant: one of ``bigtri.native.VARIANTS["cpu"]``.
        backend: "native" draws with the build that counts, "reference" works the numbers out from the stages; "auto".

    Raises:
        TypeError, ValueError: an argument of another dtype, shape or value; the text names it.
        RuntimeError: an index in ``triangles`` is out of range; the rung's work is not counted.
    """
    op = "count"
    chosen = arguments.choose_backend(op, backend)
    arguments.check_choice(op, "variant", variant, tuple(COUNTS))
    arithmetic = arguments.check_precision(op, precision)
    arguments.check_choice(op, "cull", cull, CULLS)
    height, width = arguments.check_image_size(op, "resolution", resolution)
    box = arguments.check_scissor(op, scissor, height, width)
    clip = arguments.check_tensor(op, "positions", positions, torch.float32, "[V, 4] or [B, V, 4]", (2, 3), "reference").cpu()
    faces = arguments.check_tensor(op, "triangles", triangles, torch.int32, "[T, 3]", 2, "reference").cpu()
    arguments.check_size(op, "positions", clip, -1, 4, "x, y, z, w")
    arguments.check_size(op, "triangles", faces, 1, 3, "corners")
    views = clip if clip.ndim == 3 else clip[None]
    check_indices(op, faces, views.shape[1])
    if chosen == "reference":
        total: dict[str, int] = {}
        for view in views:
            records, _ = reference.setup(view.numpy(), faces.numpy(), height, width, cull, box, arithmetic)
            for name, n in COUNTS[variant](records, arithmetic).items():
                total[name] = total.get(name, 0) + n
        return {name: n for name, n in total.items() if n}
    arguments.check_compiled(op, arithmetic, "cpu")
    arguments.check_choice(op, "variant", variant, tuple(native.REGISTRY["cpu"][arithmetic.name]))
    counters = torch.zeros(len(native.COUNTERS), dtype=torch.int64)
    parameters = native.parameter_values(op, native.REGISTRY["cpu"][arithmetic.name][variant], None)
    packed = torch.empty((*clip.shape[:-2], height, width), dtype=torch.int64)
    dropped = torch.empty(clip.shape[:-2], dtype=torch.int64)
    drawing = (clip, faces, height, width, cull, box, variant, arithmetic.name, 1, parameters, None, None)
    torch.ops.bigtri.rasterize(*drawing, packed, None, dropped, counters)
    return {name: int(n) for name, n in zip(native.COUNTERS, counters, strict=True) if n}
