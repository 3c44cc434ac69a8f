"""The rungs of the precision ladder on CUDA without a GPU, in bits: each one's kernels, run by cuda_on_cpu.py, against the NumPy
reference, and the CPU where it is built for the rung."""

from __future__ import annotations

import functools
from typing import NamedTuple

import cuda_on_cpu
import numpy as np
import pytest
import torch
from cases import CASES, Case, random_corners, soup
from cuda_bits import CONSTRUCTIONS, PATHS
from cuda_on_cpu import DRAWN_AS_EXACT, VARIANTS_OF, Job
from numpy.typing import NDArray
from picture_cases import drawn, picture_of
from test_cuda_attributes_on_cpu import bits, interpolate
from test_cuda_on_cpu import PIXELS
from test_cuda_pictures_on_cpu import differences as differences_of_pictures

import bigtri
from bigtri import native, reference
from bigtri.precision import DEFAULT, PRESETS, RUNGS
from bigtri.reference.numerics import BACKGROUND
from bigtri.study.accuracy import reversed_depth

pytestmark = [
    pytest.mark.skipif(bool(cuda_on_cpu.available()), reason=cuda_on_cpu.available()),
    pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning"),
]

OTHER_PRESETS = [rung for rung in PRESETS if rung != DEFAULT]
CASES_OF_PRESETS = [*CASES, "mixed", "full_screens"]
OTHERS = [rung for rung in VARIANTS_OF if rung != DEFAULT]
NAMES = ("guard_band", "behind_camera", "far_depth", "on_centres", "corner_of_huge", "half_subpixels", "clipped_fans", "assorted")
SETTINGS = ({}, {"queue": 1}, {"widest": 8, "share": 4}, {"rows": 0, "share": 128, "blocks": 3})


def assorted(rng: np.random.Generator) -> Case:
    """Small, large, thin and clipped triangles, which cross bins, some with edges too long for float32, and one not finite."""
    small = random_corners(rng, 120, 0.9)
    small[:, 1:] = small[:, :1] + rng.normal(0, 0.04, (120, 2, 4)) * [1, 1, 0, 0]
    thin = random_corners(rng, 40, 1.0)
    thin[:, 2, :2] = thin[:, 1, :2] + rng.normal(0, 0.003, (40, 2))
    clipped = random_corners(rng, 25, 1.5, behind=True)
    endless = random_corners(rng, 12, 1.0, behind=True)
    endless[..., :2] *= 10.0 ** rng.uniform(37.5, 38.2, (12, 3, 1))
    broken = random_corners(rng, 1, 1.0)
    broken[0, 1, 2] = np.nan
    corners = [small, random_corners(rng, 25, 1.2), thin, clipped, endless, broken]
    return soup(rng.permutation(np.concatenate(corners)), (110, 150))


class Picture(NamedTuple):
    """What a rung has to draw."""

    case: Case
    packed: NDArray[np.int64]  # [H, W]
    depth: NDArray[np.float32]  # [H, W]
    dropped: int


@functools.lru_cache(maxsize=len(NAMES))
def picture(name: str, rung: str) -> Picture:
    """The reference's, which has to be the CPU's too."""
    case = (CONSTRUCTIONS | {"assorted": assorted})[name](np.random.default_rng([0, *name.encode()]))
    if RUNGS[rung].reversed:
        case = case._replace(positions=reversed_depth(case.positions))
    packed, dropped = reference.rasterize(case.positions, case.triangles, *case.resolution, arithmetic=RUNGS[rung])
    depth = np.where(packed == BACKGROUND, np.float32(np.inf), (packed >> 32).astype(np.uint32).view(np.float32))
    if rung in native.REGISTRY.get("cpu", {}):
        seen = bigtri.rasterize(case.positions, case.triangles, case.resolution, precision=rung, backend="native")
        assert np.array_equal(seen.packed, packed) and seen.dropped == dropped
    return Picture(case, packed, depth, dropped)


@pytest.mark.parametrize("rung", OTHERS)
def test_drawing(rung: str) -> None:
    """With room for all that waits and for hardly anything, by few warps and by many; each way with several pictures."""
    assert "two_stage" in VARIANTS_OF[rung], "the schedule on which rungs are compared"
    chosen = [(name, SETTINGS[number % len(SETTINGS)]) for number, name in enumerate(NAMES)] + [("assorted", {})]
    jobs = [Job(*picture(name, rung), variant, settings) for variant in VARIANTS_OF[rung] for name, settings in chosen]
    said = cuda_on_cpu.differences_in_children(cuda_on_cpu.kernels(rung), jobs)
    assert not said, said


@pytest.mark.parametrize("name", CASES_OF_PRESETS)
@pytest.mark.parametrize("rung", OTHER_PRESETS)
@pytest.mark.skipif(not native.available(), reason="the extension is not built")
def test_every_case(rung: str, name: str) -> None:
    """A preset on the default variant: a case in three of the ways through the kernels, each way with many cases. What must come
    out is the CPU's picture, which test_native.py compares with the reference."""
    case = CONSTRUCTIONS[name](np.random.default_rng([0, *name.encode()]))
    if np.prod(case.resolution) > PIXELS:
        pytest.skip("large")
    tensors = torch.from_numpy(case.positions), torch.from_numpy(case.triangles)
    seen = bigtri.rasterize(*tensors, case.resolution, precision=rung, backend="native")
    assert seen.depth is not None
    wanted = case, seen.packed.numpy(), seen.depth.numpy(), int(seen.dropped)
    number = CASES_OF_PRESETS.index(name)
    ways = [way for turn, way in enumerate(PATHS.values()) if rung not in DRAWN_AS_EXACT and turn % 3 == number % 3] or [{}]
    jobs = [Job(*wanted, VARIANTS_OF[rung][0], settings) for settings in ways]
    said = cuda_on_cpu.differences_in_children(cuda_on_cpu.kernels(rung), jobs, number)
    assert not said, said


@pytest.mark.parametrize("rung", OTHERS)
def test_interpolation(rung: str) -> None:
    """Of the rung's own pictures, and of a buffer that names triangles where it does not draw them."""
    own = [(picture(name, rung).case, picture(name, rung).packed) for name in ("clipped_fans", "assorted")]
    case, packed = own[-1]
    anywhere = np.random.default_rng(1).integers(0, len(case.triangles), packed.shape)
    known = {"backend": "reference", "precision": rung}
    calls = [(case, anywhere, None, bigtri.barycentrics(anywhere, case.positions, case.triangles, **known))]
    for case, packed in own:
        attributes = np.random.default_rng(2).normal(size=(len(case.positions), 2)).astype(np.float32)
        values = bigtri.interpolate(attributes, packed, case.positions, case.triangles, **known)
        calls.append((case, packed, torch.from_numpy(attributes)[None], values))
    library = cuda_on_cpu.kernels(rung)

    def differences() -> list[str]:
        found = []
        for number, (case, packed, attributes, wanted) in enumerate(calls):
            library.set_order(2 * number)
            arguments = (torch.from_numpy(a) for a in (packed[None], case.positions[None], case.triangles))
            got = interpolate(library, *arguments, attributes)
            if count := int((bits(got)[0] != bits(torch.from_numpy(wanted))).sum()):
                found.append(f"call {number}: {count} values differ")
        return found

    said = cuda_on_cpu.in_children([differences])
    assert not said, said


@pytest.mark.parametrize("rung", OTHERS)
def test_pictures(rung: str) -> None:
    """Of the rung's own attributes, of triangles that are clipped and not, straight from triangles and of a buffer."""
    pairs = []
    # Several samples; and a picture that is shaded in areas, where the rung's variant lists them.
    for one in (picture_of(3, (26, 34), samples=2, count=40), picture_of(4, (40, 70), views=2, count=40, made=False)):
        if RUNGS[rung].reversed:
            turned = [torch.from_numpy(reversed_depth(view.numpy())) for view in one.positions]
            one = one._replace(positions=torch.stack(turned))
        pairs.append((one, drawn(one, rung, "reference")))
    said = cuda_on_cpu.in_children([functools.partial(differences_of_pictures, cuda_on_cpu.kernels(rung), pairs)])
    assert not said, said
