"""How much work a variant does for a picture, counted by the extension or worked out by the reference."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from .. import native, reference
from ..choices import CULLS
from ..ops import arguments
from ..ops.arguments import Array
from ..ops.rasterize import check_indices
from ..precision import DEFAULT, Arithmetic, Precision
from ..reference.numerics import TILE
from ..reference.variants import MODELS
from ..reference.work import Job, without_empty
from ..reference.work_map import Places, levels_of

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
            variants of ``exact`` count their work, as far as their kernels do it (docs/variants.md).
        parameters: values of the variant's parameters by name, instead of the standard ones.

    Raises:
        TypeError, ValueError: an argument of another dtype, shape or value; the text names it.
        RuntimeError: an index in ``triangles`` is out of range; the rung's work is not counted; there is no CUDA device, or
            none that counts.
    """
    op = "count"
    backend, device = choose_where(op, backend, device, variant)
    scene = Scene.checked(op, positions, triangles, resolution, precision, cull, scissor, (2, 3))
    clip, faces, (height, width), arithmetic, _, box = scene
    views = (scene._replace(clip=view) for view in (clip if clip.ndim == 3 else clip[None]))
    if backend == "reference":
        return _of_all(modelled(op, view, variant, parameters)[0] for view in views)
    if device == "cuda":
        return _of_all(drawn_on_cuda(op, view, variant, parameters).counters for view in views)
    counters = torch.zeros(len(native.COUNTERS), dtype=torch.int64)
    packed = torch.empty((*clip.shape[:-2], height, width), dtype=torch.int64)
    dropped = torch.empty(clip.shape[:-2], dtype=torch.int64)
    values = chosen_values(op, scene, variant, parameters, device)
    drawing = (clip, faces, height, width, cull, box, variant, arithmetic.name, 1, values, None, None)
    torch.ops.bigtri.rasterize(*drawing, packed, None, dropped, counters)
    return by_name(counters)


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


def choose_where(op: str, backend: str, device: str, variant: str) -> tuple[str, str]:
    """The backend, and the device that it draws on, with a variant that is known there.

    Raises:
        ValueError, RuntimeError: as ``count``.
    """
    chosen = arguments.choose_backend(op, backend)
    arguments.check_choice(op, "device", device, ("cpu", "cuda"))
    on_cuda = chosen == "native" and device == "cuda"
    if on_cuda and "cuda" not in native.devices():
        raise RuntimeError(f"bigtri.{op}: device='cuda' needs a CUDA device, and the extension built for CUDA")
    arguments.check_choice(op, "variant", variant, native.VARIANTS["cuda"] if on_cuda else tuple(MODELS))
    return chosen, "cuda" if on_cuda else "cpu"


def chosen_values(op: str, scene: Scene, variant: str, parameters: Mapping[str, int] | None, device: str) -> list[int]:
    """The variant's parameters, for the operators.

    Raises:
        ValueError, RuntimeError: as ``count``.
    """
    arguments.check_compiled(op, scene.arithmetic, device)
    known = native.REGISTRY[device][scene.arithmetic.name]
    arguments.check_choice(op, "variant", variant, tuple(known))
    return native.parameter_values(op, known[variant], parameters)


class OnCuda(NamedTuple):
    """What kernels that count say of a view."""

    counters: dict[str, int]  # those that are not 0
    fragments: NDArray[np.int64]  # [64 rows, 64 columns], of bins: those offered to each pixel
    blocks: NDArray[np.int64]  # [N]: those that each block of the kernel offered


def drawn_on_cuda(op: str, scene: Scene, variant: str, parameters: Mapping[str, int] | None) -> OnCuda:
    """One view, drawn by kernels that count.

    Raises:
        ValueError, RuntimeError: as ``count``.
    """
    clip, faces, (height, width), arithmetic, cull, box = scene
    values = chosen_values(op, scene, variant, parameters, "cuda")
    image = [TILE * size for size in levels_of(height, width)[0]]
    room = 1024
    while True:
        shapes = (height, width), (), [len(native.COUNTERS)], image, [0], [room]
        outputs = [torch.zeros(shape, dtype=torch.int64, device="cuda") for shape in shapes]
        drawing = (clip.cuda(), faces.cuda(), height, width, cull, box, variant, arithmetic.name, values)
        torch.ops.bigtri.map_work(*drawing, *outputs)
        _, _, counters, fragments, _, blocks = (output.cpu() for output in outputs)
        if blocks.sum() == fragments.sum():  # else the kernel has more blocks
            return OnCuda(by_name(counters), fragments.numpy(), blocks.numpy())
        room *= 8


def by_name(counters: torch.Tensor) -> dict[str, int]:
    """Counters as the operators write them, those that are not 0."""
    return {name: int(n) for name, n in zip(native.COUNTERS, counters, strict=True) if n}


def _of_all(views: Iterable[Mapping[str, int]]) -> dict[str, int]:
    total: dict[str, int] = {}
    for counts in views:
        for name, n in counts.items():
            total[name] = max(total.get(name, 0), n) if name in LARGEST else total.get(name, 0) + n
    return total


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
