"""The extension: which of its libraries load, the instruction set in use, and what its operators return (fake kernels).

There are two libraries. ``bigtri._C`` defines the operators and draws on the CPU; ``bigtri._cuda`` adds the kernels for
CUDA and is optional, so that a CUDA runtime that is missing or wrong does not take the CPU away.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import torch

from . import warn

ISA_LEVELS = ("baseline", "avx2", "avx512")


class _Library(NamedTuple):
    there: bool  # whether its file lies in the package
    error: str  # why it did not load; empty if it did


def _load(name: str) -> _Library:
    there = importlib.util.find_spec(name) is not None
    try:
        importlib.import_module(name)
    except ImportError as error:
        return _Library(there, str(error) or repr(error))
    return _Library(there, "")


def _load_libraries() -> dict[str, _Library]:
    """The library that draws on each kind of device. Where the first does not load, the second is not tried."""
    cpu = _load("bigtri._C")
    return {"cpu": cpu, "cuda": cpu if cpu.error else _load("bigtri._cuda")}


_LIBRARIES = _load_libraries()


def _variants() -> dict[str, tuple[str, ...]]:
    """Per kind of device the extension draws on, how it can schedule the work there."""
    found = {}
    if not _LIBRARIES["cpu"].error:
        found["cpu"] = tuple(torch.ops.bigtri.variants().split(","))
        if hasattr(torch.ops.bigtri, "cuda_variants"):  # the kernels for CUDA come with it
            found["cuda"] = tuple(torch.ops.bigtri.cuda_variants().split(","))
    return found


# For each kind of device that the extension is built for ("cpu", "cuda"), and whose library loads: how it can schedule
# the work, the one that "auto" means first. All give the same bits.
VARIANTS: dict[str, tuple[str, ...]] = _variants()


def available() -> bool:
    """Whether the extension is built and loads; for CUDA that is ``"cuda" in VARIANTS``."""
    return "cpu" in VARIANTS


def load_error(kind: str = "cpu") -> str:
    """Why the extension does not draw on a kind of device, "cpu" or "cuda"; empty if it does.

    A machine without a GPU is no such reason: the library for CUDA loads wherever there is a CUDA runtime.
    """
    return "" if kind in VARIANTS else _LIBRARIES[kind].error


def is_broken(kind: str = "cpu") -> bool:
    """Whether a library for this kind of device lies in the package, but does not load."""
    return kind not in VARIANTS and _LIBRARIES[kind].there


def warn_if_broken(kind: str) -> None:
    """A RuntimeWarning with the reason, once in the process, where ``is_broken(kind)``."""
    if is_broken(kind):
        without = {
            "cpu": "backend='auto' falls back to the NumPy reference: the same bits, 30 to 70 times slower",
            "cuda": "nothing is drawn from CUDA tensors, only from those on the CPU",
        }
        what = f"bigtri: the extension's library for {kind} is there but does not load, so {without[kind]}"
        warn.once(f"broken {kind}", f"{what}. {load_error(kind)}", RuntimeWarning)


def devices() -> list[str]:
    """The kinds of device that the extension draws on here: "cpu", and "cuda" if it is built for CUDA and there is one.

    Warns, once in the process, where there is one and the library for CUDA does not load. ``load_error("cuda")`` says why.
    """
    if available() and torch.cuda.is_available():
        warn_if_broken("cuda")
    return [kind for kind in VARIANTS if kind == "cpu" or torch.cuda.is_available()]


def isa_levels() -> list[str]:
    """The instruction sets that this machine can run, slowest first; all give the same bits. Empty without the extension."""
    return [name for name in ISA_LEVELS if available() and torch.ops.bigtri.has_isa(name)]


def isa() -> str:
    """The instruction set in use: the best one, or what the environment variable BIGTRI_ISA or ``set_isa`` asked for."""
    return torch.ops.bigtri.isa()


def set_isa(name: str) -> None:
    """Run on another instruction set from now on, in the whole process.

    Raises:
        RuntimeError: this machine does not have it.
    """
    torch.ops.bigtri.set_isa(name)


@contextmanager
def using_isa(name: str) -> Iterator[None]:
    """``set_isa(name)`` for the length of a with block."""
    before = isa()
    set_isa(name)
    try:
        yield
    finally:
        set_isa(before)


@contextmanager
def batch_limits(records: int, candidates: int) -> Iterator[None]:
    """Let a batch hold no more than this for the length of a with block, in the whole process: more batches, the same bits.

    Args:
        records: (sub)triangles set up at once, >= 1; 96 bytes each.
        candidates: bins that their bounding boxes touch, >= 1; 12 bytes each.
    """
    before = torch.ops.bigtri.batch_limits()
    torch.ops.bigtri.set_batch_limits(records, candidates)
    try:
        yield
    finally:
        torch.ops.bigtri.set_batch_limits(*before)


class CudaTuning(NamedTuple):
    """How the CUDA kernels are launched. No setting changes a bit of the picture; docs/cuda.md has the measurements behind them.

    few: up to so many triangles, and 16 for each warp of a block, every block sets up all of them by itself.
    some: up to so many, blocks write the pixels that they own, then small triangles follow; above, small triangles come first.
    warps: of a block that owns pixels, 4, 8 or 16; 0 for what suits the number of triangles.
    blocks: of kernels whose blocks take work in turns; 0 for as many as the device holds.
    entries: records that a block draws together, 1 to 352, at most 22 for each of its warps.
    queue: records that may wait; what finds no room is drawn on the spot, or last.
    threshold: px of bbox above which a record waits for a block that owns the bin; small ones never do.
    cache: bytes that the device's cache holds; 0 for what the device says.
    """

    few: int
    some: int
    warps: int
    blocks: int
    entries: int
    queue: int
    threshold: int
    cache: int


@contextmanager
def cuda_tuning(**changes: int) -> Iterator[CudaTuning]:
    """Launch the CUDA kernels with other settings, fields of ``CudaTuning``, within a with block, in the whole process.

    Raises:
        RuntimeError: the extension is not built for CUDA, or a setting is out of range.
        TypeError: no such setting.
    """
    if "cuda" not in VARIANTS:
        raise RuntimeError("bigtri.native.cuda_tuning: the extension is not built for CUDA")
    if unknown := set(changes) - set(CudaTuning._fields):
        raise TypeError(
            f"bigtri.native.cuda_tuning: settings are {', '.join(CudaTuning._fields)}, got {', '.join(sorted(unknown))}"
        )
    before = CudaTuning(*torch.ops.bigtri.cuda_tuning())
    after = before._replace(**changes)
    torch.ops.bigtri.set_cuda_tuning(list(after))
    try:
        yield after
    finally:
        torch.ops.bigtri.set_cuda_tuning(list(before))


def _new_size() -> torch.SymInt:
    """A number of rows that only the data decides."""
    return torch.library.get_ctx().new_dynamic_size(min=0)


def _check_fakes(op: str, **arguments: tuple[torch.Tensor | None, int]) -> None:
    """Raise RuntimeError unless every tensor has its number of dimensions and is on the first one's device.

    torch runs a fake kernel wherever one argument is on the meta device, so the real operator's checks do not see such a call.
    """
    place = next(value.device for value, _ in arguments.values() if value is not None)
    for name, (value, ndim) in arguments.items():
        if value is not None and value.ndim != ndim:
            raise RuntimeError(f"bigtri::{op}: {name} must have {ndim} dimensions, got {list(value.shape)}")
        if value is not None and value.device != place:
            raise RuntimeError(f"bigtri::{op}: {name} must be on {place} like {next(iter(arguments))}, got {value.device}")


def _register_fakes() -> None:
    fake = torch.library.register_fake

    @fake("bigtri::rasterize")
    def _(positions, triangles, height, width, cull, scissor, variant, packed, depth, dropped):
        inputs = {"positions": (positions, 3), "triangles": (triangles, 2)}
        _check_fakes("rasterize", **inputs, packed=(packed, 3), depth=(depth, 3), dropped=(dropped, 1))

    @fake("bigtri::setup")
    def _(positions, triangles, height, width, cull, scissor):
        _check_fakes("setup", positions=(positions, 2), triangles=(triangles, 2))
        n = _new_size()
        i32, f32, i64, f64 = torch.int32, torch.float32, torch.int64, torch.float64
        shapes = [((n,), i32), ((n, 3, 2), i32), ((n, 3), f32), ((n,), i64), ((n, 4), i32), ((n, 3), f64), ((n, 3), i32)]
        shapes += [((n, 3, 3), f64), ((n,), torch.bool), ((), i64)]
        return tuple(positions.new_empty(shape, dtype=dtype) for shape, dtype in shapes)

    @fake("bigtri::binning")
    def _(xy, bbox, threshold):
        _check_fakes("binning", xy=(xy, 3), bbox=(bbox, 2))
        candidates = _new_size()
        small = _new_size()
        return xy.new_empty((candidates, 3)), xy.new_empty((candidates,), dtype=torch.bool), xy.new_empty((small,))

    @fake("bigtri::tile_mask")
    def _(xy, bbox, queue):
        _check_fakes("tile_mask", xy=(xy, 3), bbox=(bbox, 2), queue=(queue, 2))
        masks = queue.new_empty((queue.shape[0],), dtype=torch.int64)
        return masks, torch.empty_like(masks)

    @fake("bigtri::scanline")
    def _(xy, bbox, queue, touched, small):
        _check_fakes("scanline", xy=(xy, 3), bbox=(bbox, 2), queue=(queue, 2), touched=(touched, 1), small=(small, 1))
        return xy.new_empty((_new_size(), 4))

    @fake("bigtri::depth")
    def _(xy, z, area, spans):
        _check_fakes("depth", xy=(xy, 3), z=(z, 2), area=(area, 1), spans=(spans, 2))
        return z.new_empty((_new_size(),))

    @fake("bigtri::visibility")
    def _(triangle, spans, depth, height, width):
        _check_fakes("visibility", triangle=(triangle, 1), spans=(spans, 2), depth=(depth, 1))
        return triangle.new_empty((height, width), dtype=torch.int64)

    @fake("bigtri::interpolate")
    def _(packed, positions, triangles, attributes):
        read = {"packed": (packed, 3), "positions": (positions, 3), "triangles": (triangles, 2)}
        _check_fakes("interpolate", **read, attributes=(attributes, 3))
        return attributes.new_empty((*packed.shape, attributes.shape[2]))

    @fake("bigtri::barycentrics")
    def _(packed, positions, triangles):
        _check_fakes("barycentrics", packed=(packed, 3), positions=(positions, 3), triangles=(triangles, 2))
        return positions.new_empty((*packed.shape, 3))

    @fake("bigtri::sample_texture")
    def _(texture, uv, filter, wrap):
        _check_fakes("sample_texture", texture=(texture, 3), uv=(uv, 2))
        return texture.new_empty((uv.shape[0], texture.shape[2]))

    @fake("bigtri::lambert")
    def _(normals, albedo, ambient, light_directions, light_colors):
        lights = {"light_directions": (light_directions, 2), "light_colors": (light_colors, 2)}
        _check_fakes("lambert", normals=(normals, 2), albedo=(albedo, 2), ambient=(ambient, 1), **lights)
        return torch.empty_like(albedo)

    @fake("bigtri::encode_srgb")
    def _(linear, thresholds):
        if thresholds.device.type != "cpu":  # wherever linear is
            _check_fakes("encode_srgb", linear=(linear, linear.ndim), thresholds=(thresholds, 1))
        _check_fakes("encode_srgb", thresholds=(thresholds, 1))
        return torch.empty_like(linear, dtype=torch.uint8)


if available():
    _register_fakes()
    if (wanted := os.environ.get("BIGTRI_ISA")) and wanted not in isa_levels():
        raise ImportError(f"bigtri: BIGTRI_ISA must be one of {', '.join(isa_levels())} on this machine, got {wanted!r}")
