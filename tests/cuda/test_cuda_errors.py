"""What the CUDA kernels say of wrong arguments, and that no argument breaks them."""

from __future__ import annotations

import time

import numpy as np
import pytest
import test_fuzz
import torch
from cases import random_corners, soup
from cuda_bits import DEVICE, VARIANTS, Scene, as_bits, assert_same, draw, expected, needs_cuda, operator_arguments, uploaded
from operators import call

import bigtri
from bigtri import native

pytestmark = needs_cuda


@pytest.fixture(params=VARIANTS)
def variant(request):
    return request.param


# --- Errors ------------------------------------------------------------------------------------------------------------------


def on_device(*shape: int, dtype: torch.dtype = torch.float32) -> torch.Tensor:
    return torch.zeros(shape, dtype=dtype, device=DEVICE)


I32, I64 = torch.int32, torch.int64

# The argument that is named, and what makes the call from good positions P and triangles T.
WRONG_CALLS = [
    ("triangles", lambda P, T: ((P.cpu(), T, (8, 8)), {})),
    ("triangles", lambda P, T: ((P, T.cpu(), (8, 8)), {})),
    ("positions", lambda P, T: ((P.double(), T, (8, 8)), {})),
    ("positions", lambda P, T: ((P.half(), T, (8, 8)), {})),
    ("positions", lambda P, T: ((P[:, :3], T, (8, 8)), {})),
    ("positions", lambda P, T: ((P[0], T, (8, 8)), {})),
    ("positions", lambda P, T: ((P.to_sparse(), T, (8, 8)), {})),
    ("triangles", lambda P, T: ((P, T.long(), (8, 8)), {})),
    ("triangles", lambda P, T: ((P, T[:, :2], (8, 8)), {})),
    ("triangles", lambda P, T: ((P, T.to("meta"), (8, 8)), {})),
    ("resolution", lambda P, T: ((P, T, (0, 8)), {})),
    ("resolution", lambda P, T: ((P, T, (8, 16385)), {})),
    ("cull", lambda P, T: ((P, T, (8, 8)), {"cull": "both"})),
    ("variant", lambda P, T: ((P, T, (8, 8)), {"variant": "fast"})),
    ("scissor", lambda P, T: ((P, T, (8, 8)), {"scissor": (5, 0, 2, 8)})),
    ("out", lambda P, T: ((P, T, (8, 8)), {"out": torch.zeros(8, 8, dtype=I64)})),
    ("out", lambda P, T: ((P, T, (8, 8)), {"out": np.zeros((8, 8), np.int64)})),
    ("out", lambda P, T: ((P, T, (8, 8)), {"out": on_device(8, 9, dtype=I64)})),
    ("out", lambda P, T: ((P, T, (8, 8)), {"out": on_device(8, 8)})),
    ("out", lambda P, T: ((P, T, (8, 8)), {"out": on_device(8, 16, dtype=I64)[:, ::2]})),
    ("out", lambda P, T: ((P.cpu(), T.cpu(), (8, 8)), {"out": on_device(8, 8, dtype=I64)})),
]


@pytest.mark.parametrize("number", range(len(WRONG_CALLS)))
def test_errors_name_the_argument(number):
    argument, make = WRONG_CALLS[number]
    positions, triangles, _ = uploaded(Scene("screen_size"))
    arguments, keywords = make(positions, triangles)
    with pytest.raises((TypeError, ValueError), match=rf"bigtri\.rasterize: {argument} "):
        bigtri.rasterize(*arguments, **keywords)
    assert_same(expected(Scene("screen_size")), draw(Scene("screen_size")))


# Position of each argument of the operator, its name, and what to put there.
WRONG_ARGUMENTS = [
    *(
        (k, name, lambda t: t.cpu())
        for k, name in ((0, "positions"), (1, "triangles"), (12, "packed"), (13, "depth"), (14, "dropped"))
    ),
    *(
        (k, name, lambda t: t.half())
        for k, name in ((0, "positions"), (1, "triangles"), (12, "packed"), (13, "depth"), (14, "dropped"))
    ),
    *(
        (k, name, lambda t: t[None])
        for k, name in ((0, "positions"), (1, "triangles"), (12, "packed"), (13, "depth"), (14, "dropped"))
    ),
    *((k, name, lambda t: t.transpose(1, 2)) for k, name in ((0, "positions"), (12, "packed"), (13, "depth"))),
    (12, "packed", lambda t: t[:, :-1]),
    (13, "depth", lambda t: t[:, :-1]),
    (14, "dropped", lambda t: t[:0]),
    (2, "height", lambda _: 0),
    (2, "packed", lambda h: h + 1),
    (3, "height and width", lambda _: 2**40),
    (4, "cull", lambda _: ""),
    (5, "scissor", lambda _: [1, 2, 3]),
    (6, "variant", lambda _: "auto"),
    (7, "precision", lambda _: "precise"),
    (8, "samples", lambda _: 4),
    (9, "parameters", lambda _: [1] * 99),
    (10, "ranges", lambda _: torch.zeros(1, 2, dtype=torch.int32, device=DEVICE)),
    (11, "behind", lambda _: torch.zeros(1, 8, 8, dtype=torch.int64, device=DEVICE)),
    (15, "counters", lambda _: torch.zeros(len(native.COUNTERS), dtype=torch.int64, device=DEVICE)),
]


@pytest.mark.parametrize("number", range(len(WRONG_ARGUMENTS)))
def test_the_operator_names_the_argument(number, variant):
    """Called directly: nothing is left to the checks before it."""
    place, name, spoil = WRONG_ARGUMENTS[number]
    arguments = operator_arguments(variant)
    wrong = (*arguments[:place], spoil(arguments[place]), *arguments[place + 1 :])
    with pytest.raises(RuntimeError, match=rf"bigtri::rasterize: {name}"):
        call("rasterize", wrong)
    assert not arguments[12].any() and not arguments[14].any()  # nothing was drawn
    call("rasterize", arguments)
    assert torch.equal(arguments[12][0], expected(Scene("screen_size")).packed)


@pytest.mark.parametrize(("output", "name"), [(12, "packed"), (13, "depth"), (14, "dropped")])
@pytest.mark.parametrize(("place", "with_what"), [(0, "positions"), (1, "triangles")])
def test_an_output_over_an_input(output, name, place, with_what, variant):
    """Indices that change while they are read would lead anywhere."""
    arguments = list(operator_arguments(variant))
    memory = torch.zeros(2**20, dtype=torch.uint8, device=DEVICE)
    given, written = arguments[place], arguments[output]
    size = given.numel() * given.element_size()
    arguments[place] = memory[:size].view(given.dtype).view(given.shape).copy_(given)
    start = (size - 1) // 8 * 8  # the last bytes
    arguments[output] = memory[start : start + written.numel() * written.element_size()].view(written.dtype).view(written.shape)
    with pytest.raises(RuntimeError, match=f"{name} must not share memory with {with_what}"):
        call("rasterize", tuple(arguments))
    assert torch.equal(arguments[place], given)
    arguments[place] = given
    call("rasterize", tuple(arguments))
    assert torch.equal(arguments[12][0], expected(Scene("screen_size")).packed)


def test_out_over_an_input():
    memory = torch.zeros(64, dtype=I64, device=DEVICE)
    case = soup(random_corners(np.random.default_rng(0), 1, 1), (8, 8))
    positions = memory.view(torch.float32)[40:52].view(3, 4).copy_(torch.from_numpy(case.positions))
    with pytest.raises(ValueError, match="out must not share memory with positions"):
        bigtri.rasterize(positions, torch.from_numpy(case.triangles).to(DEVICE), (8, 8), out=memory.view(8, 8))


# --- Arguments of every kind -------------------------------------------------------------------------------------------------

SECONDS = 6.0  # per variant


def fuzzed(source: test_fuzz.Source, variant: str, settings: dict[str, int]) -> tuple[list, bool]:
    """Arguments of the operator, on the device but for some, and whether they were left as they should be."""
    arguments = list(test_fuzz.rasterize(source)[0])
    arguments[6] = variant if source.chance(0.95) else "auto"
    known = native.REGISTRY["cuda"]["exact"][variant]
    own = {name: value for name, value in settings.items() if name in known.parameters}
    served = source.chance(0.95)
    if served:
        arguments[7:12] = "exact", 1, native.parameter_values("fuzz", known, own), None, None
    arguments[15] = None
    valid = served and not source.chance(0.35)
    if not valid and source.chance(0.7):
        k = int(source.rng.integers(len(arguments)))
        arguments[k] = source.spoiled(arguments[k])
    stays = -1 if valid or source.chance(0.8) else int(source.rng.integers(len(arguments)))
    for k, argument in enumerate(arguments):
        if isinstance(argument, torch.Tensor) and not argument.is_meta and k != stays:
            arguments[k] = argument.to(DEVICE)
    return arguments, valid


def on_the_cpu(arguments: list) -> list[torch.Tensor | None] | None:
    """The outputs of the same call there; None if it raises, as for an index out of range."""
    copies = [a.detach().cpu().clone() if isinstance(a, torch.Tensor) else a for a in arguments]
    copies[6], copies[9] = native.VARIANTS["cpu"][0], []
    try:
        call("rasterize", tuple(copies))
    except RuntimeError:
        return None
    return copies[12:15]


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("settings", [{}, {"few": 0, "widest": 1, "queue": 1}, {"few": 3, "share": 1024, "entries": 2}])
def test_the_operator_returns_or_raises(settings, variant):
    """Random arguments never crash it nor leave an error behind, and what it draws is what the CPU draws."""
    stop, returned, raised, compared = time.monotonic() + SECONDS / 3, 0, 0, 0
    for seed in range(3000):
        arguments, valid = fuzzed(test_fuzz.Source(seed), variant, settings)
        for output in arguments[12:15]:
            if valid and isinstance(output, torch.Tensor):
                output.fill_(seed % 3 - 1)
        try:
            call("rasterize", tuple(arguments))
        except Exception as error:
            raised += 1
            assert "API call failed" not in str(error), (seed, error)
            torch.cuda.synchronize()
            assert not valid or arguments[6] != variant or on_the_cpu(arguments) is None, seed
            continue
        torch.cuda.synchronize()
        returned += 1
        if valid and (wanted := on_the_cpu(arguments)) is not None:
            compared += 1
            for a, b in zip(wanted, arguments[12:15], strict=True):
                assert (a is None) == (b is None), seed
                assert a is None or torch.equal(as_bits(a), as_bits(b.cpu())), seed
        if time.monotonic() > stop:
            break
    assert returned and raised and compared
    assert_same(expected(Scene("mixed")), draw(Scene("mixed"), variant=variant))
    torch.cuda.synchronize()
