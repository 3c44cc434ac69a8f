"""How much work a variant does for a picture, counted by the extension or worked out by the reference."""

from __future__ import annotations

from collections.abc import Mapping

import torch

from .. import native, reference
from ..choices import CULLS
from ..ops import arguments
from ..ops.arguments import Array
from ..ops.rasterize import check_indices
from ..precision import DEFAULT, Precision
from ..reference.variants import MODELS
from ..reference.work import Job, without_empty

Scissor = tuple[int, int, int, int]
LARGEST = ("most_work",)  # of views and tasks the largest counts, where other counters are sums


def count(
    positions: Array,
    triangles: Array,
    resolution: tuple[int, int],
    *,
    variant: str,
    backend: str = "auto",
    device: str = "cpu",
    precision: str | Precision = DEFAULT,
    cull: str = "none",
    scissor: Scissor | None = None,
    parameters: Mapping[str, int] | None = None,
) -> dict[str, int]:
    """The counters of csrc/core/counters.h that are not 0, by name, of all views together.

    Both backends count the same, but for what depends on the order in which threads work (``bigtri.native.COUNTERS`` says
    which counters do): of that the reference has what one thread does.

    Args:
        positions, triangles, resolution, cull, scissor, precision: as for ``rasterize``; on the CPU.
        variant: one of ``bigtri.native.VARIANTS["cpu"]``.
        backend: "native" draws with the build that counts, "reference" works the numbers out from the stages; "auto".
        device: where the native backend draws: "cpu", or "cuda", if it was built with ``BIGTRI_CUDA_COUNTING=1``. There the
            published designs count some of their work (docs/variants.md).
        parameters: values of the variant's parameters by name, instead of the standard ones.

    Raises:
        TypeError, ValueError: an argument of another dtype, shape or value; the text names it.
        RuntimeError: an index in ``triangles`` is out of range; the rung's work is not counted; there is no CUDA device, or
            none that counts.
    """
    op = "count"
    chosen = arguments.choose_backend(op, backend)
    arguments.check_choice(op, "device", device, ("cpu", "cuda"))
    on_cuda = chosen == "native" and device == "cuda"
    if on_cuda and "cuda" not in native.devices():
        raise RuntimeError("bigtri.count: device='cuda' needs a CUDA device, and the extension built for CUDA")
    arguments.check_choice(op, "variant", variant, native.VARIANTS["cuda"] if on_cuda else tuple(MODELS))
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
        values = _all_parameters(op, variant, parameters)
        for view in views:
            mesh = view.numpy(), faces.numpy()
            records, _ = reference.setup(*mesh, height, width, cull, box, arithmetic)
            records = without_empty(records, arithmetic)
            for name, n in MODELS[variant].count(Job(*mesh, records, height, width, arithmetic, values)).items():
                total[name] = max(total.get(name, 0), n) if name in LARGEST else total.get(name, 0) + n
        return {name: n for name, n in total.items() if n}
    arguments.check_compiled(op, arithmetic, device)
    known = native.REGISTRY[device][arithmetic.name]
    arguments.check_choice(op, "variant", variant, tuple(known))
    counters = torch.zeros(len(native.COUNTERS), dtype=torch.int64, device=device)
    chosen_values = native.parameter_values(op, known[variant], parameters)
    packed = torch.empty((*clip.shape[:-2], height, width), dtype=torch.int64, device=device)
    dropped = torch.empty(clip.shape[:-2], dtype=torch.int64, device=device)
    placed = clip.to(device), faces.to(device)
    drawing = (*placed, height, width, cull, box, variant, arithmetic.name, 1, chosen_values, None, None)
    torch.ops.bigtri.rasterize(*drawing, packed, None, dropped, counters)
    return {name: int(n) for name, n in zip(native.COUNTERS, counters, strict=True) if n}


def load(counts: Mapping[str, int]) -> float:
    """How unevenly a variant's tasks are loaded: the most work that one of them has, over the mean. 0 if nothing was drawn."""
    return counts["most_work"] * counts["tasks"] / counts["work"] if counts.get("work") else 0.0


def _all_parameters(op: str, variant: str, given: Mapping[str, int] | None) -> dict[str, int]:
    standard = MODELS[variant].STANDARD
    for name in given or {}:
        if name not in standard:
            raise ValueError(f"bigtri.{op}: parameters of variant {variant!r} are {', '.join(standard) or 'none'}, got {name!r}")
    return {**standard, **(given or {})}
