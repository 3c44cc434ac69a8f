"""How much work a variant does for a picture, counted by the extension or worked out by the reference."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import torch

from .. import native, reference
from ..choices import CULLS
from ..ops import arguments
from ..ops.arguments import Array
from ..ops.rasterize import check_indices
from ..precision import DEFAULT, Arithmetic, Precision
from ..reference.variants import MODELS
from ..reference.work import Job, without_empty
from ..reference.work_map import Places

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
    scene = Scene.checked(op, positions, triangles, resolution, precision, cull, scissor, (2, 3))
    clip, faces, (height, width), arithmetic, _, box = scene
    if chosen == "reference":
        total: dict[str, int] = {}
        for view in clip if clip.ndim == 3 else clip[None]:
            counts, _ = modelled(op, scene._replace(clip=view), variant, parameters)
            for name, n in counts.items():
                total[name] = max(total.get(name, 0), n) if name in LARGEST else total.get(name, 0) + n
        return total
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


class Scene(NamedTuple):
    """What is drawn, checked; on the CPU."""

    clip: torch.Tensor  # float32 [V, 4] or [B, V, 4]
    faces: torch.Tensor  # int32 [T, 3]
    resolution: tuple[int, int]  # height, width
    arithmetic: Arithmetic
    cull: str
    box: Scissor

    @classmethod
    def checked(
        cls,
        op: str,
        positions: Array,
        triangles: Array,
        resolution: tuple[int, int],
        precision: str | Precision,
        cull: str,
        scissor: Scissor | None,
        dimensions: int | tuple[int, ...],
    ) -> Scene:
        """The arguments of ``count``; positions of so many ``dimensions``.

        Raises:
            TypeError, ValueError, RuntimeError: as ``count``.
        """
        arithmetic = arguments.check_precision(op, precision)
        arguments.check_choice(op, "cull", cull, CULLS)
        height, width = arguments.check_image_size(op, "resolution", resolution)
        box = arguments.check_scissor(op, scissor, height, width)
        shape = "[V, 4]" if dimensions == 2 else "[V, 4] or [B, V, 4]"
        clip = arguments.check_tensor(op, "positions", positions, torch.float32, shape, dimensions, "reference").cpu()
        faces = arguments.check_tensor(op, "triangles", triangles, torch.int32, "[T, 3]", 2, "reference").cpu()
        arguments.check_size(op, "positions", clip, -1, 4, "x, y, z, w")
        arguments.check_size(op, "triangles", faces, 1, 3, "corners")
        check_indices(op, faces, clip.shape[-2])
        return cls(clip, faces, (height, width), arithmetic, cull, box)


def modelled(op: str, scene: Scene, variant: str, parameters: Mapping[str, int] | None) -> tuple[dict[str, int], Places]:
    """What the variant's model counts of one view, those that are not 0, and where."""
    values = _all_parameters(op, variant, parameters)
    mesh = scene.clip.numpy(), scene.faces.numpy()
    records, _ = reference.setup(*mesh, *scene.resolution, scene.cull, scene.box, scene.arithmetic)
    places, drawn = Places(*scene.resolution), without_empty(records, scene.arithmetic)
    counts = MODELS[variant].count(Job(*mesh, drawn, *scene.resolution, scene.arithmetic, values, places))
    return {name: n for name, n in counts.items() if n}, places


def load(counts: Mapping[str, int]) -> float:
    """How unevenly a variant's tasks are loaded: the most work that one of them has, over the mean. 0 if nothing was drawn."""
    return counts["most_work"] * counts["tasks"] / counts["work"] if counts.get("work") else 0.0


def _all_parameters(op: str, variant: str, given: Mapping[str, int] | None) -> dict[str, int]:
    standard = MODELS[variant].STANDARD
    for name in given or {}:
        if name not in standard:
            raise ValueError(f"bigtri.{op}: parameters of variant {variant!r} are {', '.join(standard) or 'none'}, got {name!r}")
    return {**standard, **(given or {})}
