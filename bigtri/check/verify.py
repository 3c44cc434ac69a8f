"""Compare the extension, or stages and variants of one's own, with the reference in bits, and say in words where they differ.

Each stage gets the reference's output of the stage before, so that one fault is reported once, where it is; the whole
pipeline is compared at the end. docs/numerics.md leaves the order of the queue open, so what binning and scanline hand out
is compared as sets.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from typing import Any, Literal, NamedTuple, overload

import numpy as np
import torch
from numpy.typing import NDArray

from .. import native
from ..ops import arguments
from ..ops.arguments import Array
from ..ops.interpolate import barycentrics
from ..ops.rasterize import CULLS, rasterize
from ..precision import DEFAULT, PRECISIONS, RUNGS
from ..reference.numerics import LARGE_THRESHOLD
from ..reference.records import Bins, Records
from . import registered, sentences
from . import stages as one_stage
from .registered import Stage
from .sentences import Difference, same_bits

__all__ = ["Difference", "Differences", "compare", "differences", "draw", "first_difference", "same_bits"]

Scissor = tuple[int, int, int, int]

# What each stage hands out: name, dtype and shape.
_OUTPUTS: dict[str, dict[str, tuple[str, tuple[str | int, ...]]]] = {
    "setup": {
        "triangle": ("int32", ("N",)),
        "xy": ("int32", ("N", 3, 2)),
        "z": ("float32", ("N", 3)),
        "area": ("int64", ("N",)),
        "bbox": ("int32", ("N", 4)),
        "w": ("float64", ("N", 3)),
        "corner": ("int32", ("N", 3)),
        "weights": ("float64", ("N", 3, 3)),
        "clipped": ("bool", ("N",)),
        "dropped": ("int64", ()),
    },
    "binning": {"candidates": ("int32", ("C", 3)), "kept": ("bool", ("C",)), "small": ("int32", ("M",))},
    "tile_mask": {"touched": ("int64", ("Q",)), "full": ("int64", ("Q",))},
    "scanline": {"spans": ("int32", ("S", 4))},
    "depth": {"depth": ("float32", ("F",))},
    "visibility": {"packed": ("int64", ("H", "W"))},
    "rasterize": {"packed": ("int64", ("H", "W")), "dropped": ("int64", ())},
    "attributes": {"barycentrics": ("float32", ("H", "W", 3))},
}
_BY_ITSELF = tuple(stage for stage in _OUTPUTS if stage not in ("rasterize", "attributes"))  # before the whole, one by one
_SHOWN = 5  # differences of a stage that are written out


class Differences(list[Difference]):
    """All differences in the order of the stages; as text, the first few of every stage and the number of the others."""

    def __str__(self) -> str:
        lines = []
        for stage in _OUTPUTS:
            found = [difference for difference in self if difference.stage == stage]
            lines += [str(difference) for difference in found[:_SHOWN]]
            if len(found) > _SHOWN:
                lines.append(f"stage {stage}, {len(found) - _SHOWN} more differences")
        return "\n".join(lines) or "no difference"


@overload
def compare(
    positions: Array, triangles: Array, resolution: tuple[int, int], *, every: Literal[False] = False, **options: Any
) -> Difference | None: ...
@overload
def compare(
    positions: Array, triangles: Array, resolution: tuple[int, int], *, every: Literal[True], **options: Any
) -> Differences: ...
def compare(
    positions: Array, triangles: Array, resolution: tuple[int, int], *, every: bool = False, **options: Any
) -> Difference | Differences | None:
    """Run every stage on both backends, or on the reference and a variant or callables of your own.

    Args:
        positions, triangles, resolution, **options: as for ``differences``.
        every: whether to go on after the first difference. ``differences`` holds one at a time, where there may be millions.

    Returns:
        The first difference, or None if all bits are equal; with ``every``, a list of all of them.

    Raises:
        As ``differences``.
    """
    arguments.check_flag("verify.compare", "every", every)
    found = differences(positions, triangles, resolution, **options)
    return Differences(found) if every else next(found, None)


def differences(
    positions: Array,
    triangles: Array,
    resolution: tuple[int, int],
    *,
    cull: str = "none",
    scissor: Scissor | None = None,
    variant: str = "auto",
    precision: str = DEFAULT,
    threshold: int = LARGE_THRESHOLD,
    stages: Mapping[str, Stage] | None = None,
) -> Iterator[Difference]:
    """Run every stage on both backends, on the CPU, and yield the differences one by one; a stage runs when its turn comes.

    Args:
        positions: float32 [V, 4], clip space.
        triangles: int32 [T, 3].
        resolution: (height, width), px.
        cull, scissor: as for ``rasterize``; ``native.using_isa`` around the call chooses the instruction set.
        variant: as for ``rasterize``, or one that ``register_variant`` or ``register_stage`` was given. Of the latter its own
            stages are compared, and the whole as it draws it, but nothing of the extension.
        precision: a rung's name. Some hand more than these outputs from stage to stage: of those the whole alone is compared.
        threshold: of the binning stage, px of bbox.
        stages: your own callables by name, compared in place of the extension's stages: "setup", "binning" and whatever else
            ``bigtri.stages`` has, with the arguments and outputs of ``bigtri.reference``; "rasterize" (positions, triangles,
            height, width, cull, scissor) -> (packed, dropped) for the whole; and "attributes" (packed, positions, triangles)
            -> barycentrics float32 [H, W, 3]. Each gets, by position, NumPy arrays that it may write to (``Records`` of
            them; a scissor of four integers inside the image) and returns NumPy arrays or torch tensors. What is not named
            here is the extension's, and is not compared where that is not built.

    Raises:
        TypeError, ValueError: an argument of another type, shape or value; no such stage; an output of a callable that is not of
            the dtype or shape that its stage hands out. The text names it.
        RuntimeError: a callable raised what is this error's cause; an index in ``triangles`` is out of range; or there is neither
            the extension nor a callable.
    """
    arguments.check_choice("verify", "cull", cull, CULLS)
    arguments.check_choice("verify", "precision", precision, PRECISIONS)
    known = registered.registered_variants()
    rungs = native.REGISTRY.get("cpu", {})
    arguments.check_choice("verify", "variant", variant, ("auto", *rungs.get(precision, ()), *known))
    own = {**registered.stages_of(variant), **_checked_stages(stages)}
    if not own:
        arguments.choose_backend("verify", "native")
    if native.available() and variant not in known:
        arguments.check_compiled("verify", RUNGS[precision], "cpu")
    if not RUNGS[precision].has_stages and (given := [stage for stage in own if stage in _BY_ITSELF]):
        whole = f"stages must be 'rasterize' or 'attributes' with precision {precision!r}, which hands on more than these outputs"
        raise ValueError(f"bigtri.verify: {whole}, got {given[0]!r}")
    height, width = arguments.check_image_size("verify", "resolution", resolution)
    box = arguments.check_scissor("verify", scissor, height, width)
    scene = _as_numpy(positions), _as_numpy(triangles), height, width, cull, box
    run = _Run(*scene, variant, precision, threshold, own, variant in known)
    return run.differences()


def draw(
    variant: str,
    positions: Array,
    triangles: Array,
    resolution: tuple[int, int],
    *,
    cull: str = "none",
    scissor: Scissor | None = None,
    threshold: int = LARGE_THRESHOLD,
    precision: str = DEFAULT,
) -> tuple[NDArray[np.int64], int]:
    """What a registered variant makes of a scene, right or wrong: ``packed`` [H, W], and how many triangles are not finite.

    Arguments and errors are those of ``differences``; the stages that the variant lacks are the reference's.
    """
    arguments.check_choice("verify.draw", "variant", variant, tuple(registered.registered_variants()))
    arguments.check_choice("verify.draw", "cull", cull, CULLS)
    arguments.check_choice("verify.draw", "precision", precision, PRECISIONS)
    height, width = arguments.check_image_size("verify.draw", "resolution", resolution)
    box = arguments.check_scissor("verify.draw", scissor, height, width)
    scene = _as_numpy(positions), _as_numpy(triangles), height, width, cull, box
    run = _Run(*scene, variant, precision, threshold, registered.stages_of(variant), True)
    drawn = run._on_own("rasterize", scene, H=height, W=width) if "rasterize" in run.own else run._chained(*scene)
    return drawn[0], int(drawn[1])


def first_difference(a: NDArray[Any], b: NDArray[Any]) -> tuple[int, ...] | None:
    """Index of the first element that differs in bits; the row after the shorter one if only the length differs."""
    if a.dtype != b.dtype or a.shape[1:] != b.shape[1:]:
        return ()
    rows = min(len(a), len(b))
    wrong = np.argwhere(~same_bits(a[:rows], b[:rows]))
    if len(wrong):
        return tuple(int(i) for i in wrong[0])
    return None if len(a) == len(b) else (rows,)


class _Run(NamedTuple):
    """One scene to be drawn on both sides; ``_on_backend`` is the one place where a backend is called."""

    positions: NDArray[np.float32]
    triangles: NDArray[np.int32]
    height: int
    width: int
    cull: str
    scissor: Scissor
    variant: str
    precision: str
    threshold: int
    own: dict[str, Stage]
    registered: bool  # whether the variant is one of these, so that no stage of the extension is compared

    def differences(self) -> Iterator[Difference]:
        agree = True
        for difference in self._stage_by_stage():
            agree = False
            yield difference
        yield from self._whole(agree)

    def _stage_by_stage(self) -> Iterator[Difference]:
        by_extension = not self.registered and native.available() and RUNGS[self.precision].has_stages
        if not by_extension and not any(stage in self.own for stage in _BY_ITSELF):
            return  # what the reference makes of every stage need not fit the memory where the whole does
        size = {"H": self.height, "W": self.width}
        scene = (self.positions, self.triangles, self.height, self.width, self.cull, self.scissor)
        (*fields, dropped), got = self._both("setup", scene)
        records = _records(fields)
        if got:
            yield from sentences.setup(records, Records(*got[:-1]))
            yield from sentences.dropped("setup", int(dropped), int(got[-1]))

        fields, got = self._both("binning", (records, self.threshold))
        bins = Bins(*fields)
        if got:
            yield from sentences.binning(records, self.threshold, bins, Bins(*got))

        queue = bins.candidates[bins.kept]
        (touched, full), got = self._both("tile_mask", (records, queue), Q=len(queue))
        if got:
            yield from sentences.tile_mask(records, queue, (touched, full), (got[0], got[1]))

        (spans,), got = self._both("scanline", (records, queue, touched, bins.small))
        if got:
            yield from sentences.scanline(records, spans, got[0])

        pixels = int((spans[:, 3] - spans[:, 2]).sum(dtype=np.int64))
        (z,), got = self._both("depth", (records, spans), F=pixels)
        if got:
            yield from sentences.depth(records, spans, z, got[0])

        (packed,), got = self._both("visibility", (records, spans, z, self.height, self.width), **size)
        if got:
            yield from sentences.packed("visibility", packed, got[0])

    def _whole(self, stages_agree: bool) -> Iterator[Difference]:
        """The pipeline from end to end, and the attributes of what the reference drew."""
        size = {"H": self.height, "W": self.width}
        scene = (self.positions, self.triangles, self.height, self.width, self.cull, self.scissor)
        expected, got = self._both("rasterize", scene, **size)
        seen = expected[0]
        if got:
            blame = self._blame() if stages_agree else ""
            found = [sentences.packed("rasterize", seen, got[0]), sentences.dropped("rasterize", int(expected[1]), int(got[1]))]
            if len(got) > 2:
                found.append(sentences.depth_image(expected[2], seen, got[2]))
            for difference in itertools.chain(*found):
                yield difference._replace(sentence=difference.sentence + blame)
        expected, got = self._both("attributes", (seen, self.positions, self.triangles), **size)
        if got:
            yield from sentences.attributes(seen, expected[0], got[0])

    def _both(self, stage: str, given: tuple[Any, ...], **sizes: int) -> tuple[list[NDArray[Any]], list[NDArray[Any]]]:
        """The reference's outputs of a stage, and those that are compared with them: none where there is nothing to compare.

        ``sizes``: what the letters of ``_OUTPUTS`` stand for, as far as the arguments fix it.
        """
        expected = self._on_backend(stage, given, "reference")
        if stage in self.own:
            return expected, self._on_own(stage, given, **sizes)
        if stage == "rasterize" and self.registered and any(stage in self.own for stage in _BY_ITSELF):
            return expected, self._chained(*given)
        if self.registered or not native.available():
            return expected, []
        return expected, _checked_outputs(stage, self._on_backend(stage, given, "native"), sizes)

    def _on_own(self, stage: str, given: tuple[Any, ...], **sizes: int) -> list[NDArray[Any]]:
        """The outputs of one's own stage, which gets copies: what it writes to its arguments does not reach what follows."""
        who = f"stage {stage} of variant {self.variant!r}" if self.registered else f"stages[{stage!r}]"
        try:
            result = self.own[stage](*map(_copied, given))
        except Exception as error:
            raise RuntimeError(f"bigtri.verify: {who} raised {type(error).__name__}: {error}") from error
        return _checked_outputs(stage, _flat(stage, result), sizes)

    def _chained(self, *scene: Any) -> list[NDArray[Any]]:
        """What the variant's own stages draw, each from what the one before it made; the reference's where it has none."""

        def run(stage: str, *given: Any, **sizes: int) -> list[NDArray[Any]]:
            return self._on_own(stage, given, **sizes) if stage in self.own else self._on_backend(stage, given, "reference")

        *fields, dropped = run("setup", *scene)
        records = _records(fields)
        bins = Bins(*run("binning", records, self.threshold))
        queue = bins.candidates[bins.kept]
        touched, _ = run("tile_mask", records, queue, Q=len(queue))
        (spans,) = run("scanline", records, queue, touched, bins.small)
        (z,) = run("depth", records, spans, F=int((spans[:, 3] - spans[:, 2]).sum(dtype=np.int64)))
        (packed,) = run("visibility", records, spans, z, self.height, self.width, H=self.height, W=self.width)
        return [packed, dropped]

    def _on_backend(self, stage: str, given: tuple[Any, ...], backend: str) -> list[NDArray[Any]]:
        """The stage's outputs; of the whole, the depth image too."""
        if stage == "attributes":
            return [_as_numpy(barycentrics(*given, backend=backend, precision=self.precision))]
        if stage == "rasterize":
            options: dict[str, Any] = {"cull": self.cull, "scissor": self.scissor, "precision": self.precision}
            options["variant"] = "auto" if backend == "reference" else self.variant
            seen = rasterize(self.positions, self.triangles, (self.height, self.width), backend=backend, **options)
            return [_as_numpy(image) for image in (seen.packed, seen.dropped, seen.depth)]
        how = {} if stage == "visibility" else {"precision": self.precision}  # it takes depths of any rung
        return _flat(stage, getattr(one_stage, stage)(*given, backend=backend, **how))

    def _blame(self) -> str:
        """Whose fault it is that the whole differs where no stage does; nothing where not all of its stages were compared."""
        if self.registered and "rasterize" not in self.own:
            return "; each stage by itself agrees, so one of them depends on more than it may, such as the order of a queue"
        if "rasterize" in self.own:
            who = f"variant {self.variant!r}" if self.registered else "stages['rasterize']"
            complete = all(stage in self.own for stage in _BY_ITSELF)
        else:
            variants = native.REGISTRY["cpu"][self.precision]
            name = next(iter(variants)) if self.variant == "auto" else self.variant
            who, complete = f"variant {name!r}", not any(stage in self.own for stage in _BY_ITSELF)
            complete &= RUNGS[self.precision].has_stages
        return f"; every stage by itself agrees, so the schedule of {who} is at fault" if complete else ""


def _checked_stages(stages: Mapping[str, Stage] | None) -> dict[str, Stage]:
    if stages is None:
        return {}
    allowed = ", ".join(map(repr, _OUTPUTS))
    if not isinstance(stages, Mapping):
        raise TypeError(f"bigtri.verify: stages must map some of {allowed} to callables, got {arguments.described(stages)}")
    for name, stage in stages.items():
        if name not in _OUTPUTS:
            raise ValueError(f"bigtri.verify: stages must be named {allowed}, got {name!r}")
        if not callable(stage):
            raise TypeError(f"bigtri.verify: stages[{name!r}] must be callable, got {arguments.described(stage)}")
    return dict(stages)


def _records(fields: list[NDArray[Any]]) -> Records:
    """Of setup's outputs; exact's coverage needs no places that are not snapped."""
    return Records(*fields)._replace(place=np.zeros((len(fields[0]), 0, 2), np.float32))


def _copied(value: Any) -> Any:
    if isinstance(value, Records):
        return Records(*map(_copied, value))
    return value.copy() if isinstance(value, np.ndarray) else value


def _checked_outputs(stage: str, values: list[Any], sizes: dict[str, int]) -> list[NDArray[Any]]:
    """``values``, once they are known to be arrays of the dtypes and shapes that the stage hands out."""
    for (name, (dtype, shape)), value in zip(_OUTPUTS[stage].items(), values, strict=False):  # after the whole: its depth image
        fixed = " and ".join(f"{size} = {sizes[size]}" for size in shape if size in sizes)
        form = f"{dtype} [{', '.join(map(str, shape))}]" + (f" with {fixed}" if fixed else "")
        text = f"bigtri.verify: stage {stage} must return {name} as {form}, got {arguments.described(value)}"
        if not isinstance(value, np.ndarray) or value.dtype != dtype:
            raise TypeError(text)
        if value.ndim != len(shape) or any(
            length != (sizes.setdefault(size, length) if isinstance(size, str) else size)
            for length, size in zip(value.shape, shape, strict=True)
        ):
            raise ValueError(text)
    if stage == "scanline" and len(turned := values[0][values[0][:, 2] > values[0][:, 3]]):
        raise ValueError(f"bigtri.verify: stage scanline must return spans with lower <= upper, got {turned[0].tolist()}")
    return values


def _flat(stage: str, result: Any) -> list[Any]:
    """The outputs of a stage one after the other, as NumPy as far as that is known; setup's records field by field."""
    names = ["records", "dropped"] if stage == "setup" else list(_OUTPUTS[stage])
    if len(names) == 1:
        return [_as_numpy(result)]
    if not isinstance(result, (tuple, list)) or len(result) != len(names):
        raise _miscounted(stage, "", names, result)
    if stage == "setup":
        records, dropped = result
        compared = [
            name for name in _OUTPUTS[stage] if name != "dropped"
        ]  # the last field is for rungs that are not compared here
        if not isinstance(records, (tuple, list)) or not len(compared) <= len(records) <= len(Records._fields):
            raise _miscounted(stage, "records as ", compared, records)
        result = (*records[: len(compared)], dropped)
    return [_as_numpy(value) for value in result]


def _miscounted(stage: str, what: str, names: Any, came: Any) -> TypeError:
    got = f"{len(came)} values" if isinstance(came, (tuple, list)) else arguments.described(came)
    return TypeError(f"bigtri.verify: stage {stage} must return {what}a tuple of {', '.join(names)}, got {got}")


def _as_numpy(value: Any) -> Any:
    """A tensor as an array, and an integer as one without dimensions; anything else as it is."""
    if isinstance(value, torch.Tensor):
        return value.numpy(force=True)
    return np.array(value, np.int64) if isinstance(value, (int, np.integer)) and not isinstance(value, bool) else value
