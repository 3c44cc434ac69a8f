"""Texture lookups: texels read by hand, a scalar model of the specification, and backend against backend."""

import itertools
import math
import re
import warnings
from pathlib import Path

import numpy as np
import pytest
import torch
from backends import BACKENDS, needs_native

from bigtri import decode_srgb, native, sample_texture, warn

# Row 0 is on top: 10 20 above 30 40.
FOUR = np.array([[[10], [20]], [[30], [40]]], np.float32)


def look_up(texture, uv, backend, **how) -> list[float]:
    return sample_texture(texture, np.array(uv, np.float32), backend=backend, **how)[..., 0].tolist()


@pytest.mark.parametrize("backend", BACKENDS)
def test_v_points_up(backend):
    corners = [(0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)]
    for how in ("nearest", "bilinear"):
        assert look_up(FOUR, corners, backend, filter=how) == [30, 40, 10, 20]


@pytest.mark.parametrize("backend", BACKENDS)
def test_bilinear_by_hand(backend):
    assert look_up(FOUR, [(0.5, 0.75), (0.25, 0.5), (0.5, 0.5)], backend) == [15, 20, 25]
    # 3/8 of the width is 1/4 of the way between the texel centres at 1/4 and 3/4.
    assert look_up(FOUR, [(0.375, 0.75)], backend) == [12.5]


@pytest.mark.parametrize("backend", BACKENDS)
def test_wrapping_by_hand(backend):
    edge = [(0.0, 0.75), (1.0, 0.75), (0.25, 1.0)]
    assert look_up(FOUR, edge, backend, wrap="repeat") == [15, 15, 20]
    assert look_up(FOUR, edge, backend, wrap="clamp") == [10, 20, 10]
    beyond = [(1.25, 0.75), (-0.25, 0.75), (7.25, -2.25)]
    assert look_up(FOUR, beyond, backend, wrap="repeat", filter="nearest") == [10, 20, 10]
    assert look_up(FOUR, beyond, backend, wrap="clamp", filter="nearest") == [20, 10, 40]


@pytest.mark.parametrize("backend", BACKENDS)
def test_what_is_not_finite_reads_the_origin(backend):
    bad = [(math.nan, 0.75), (0.75, math.inf), (-math.inf, math.nan), (0, 0)]
    for how in ("nearest", "bilinear"):
        values = look_up(FOUR, bad, backend, filter=how)
        assert values == [values[-1]] * 4


def by_the_specification(texture, u, v, how, wrap):
    """docs/numerics.md section 10 for one coordinate, in scalars."""
    f = np.float32
    height, width, _ = texture.shape
    u, v = (f(u), f(v)) if np.isfinite(u) and np.isfinite(v) else (f(0), f(0))
    if wrap == "repeat":
        u, v = u - np.floor(u), v - np.floor(v)
    else:
        u, v = min(max(u, f(0)), f(1)), min(max(v, f(0)), f(1))
    if how == "nearest":
        return texture[min(int(np.floor((f(1) - v) * f(height))), height - 1), min(int(np.floor(u * f(width))), width - 1)]
    x, y = u * f(width) - f(0.5), (f(1) - v) * f(height) - f(0.5)
    tx, ty = x - np.floor(x), y - np.floor(y)

    def texel(dx, dy):
        column, row = int(np.floor(x)) + dx, int(np.floor(y)) + dy
        if wrap == "repeat":
            return texture[row % height, column % width]
        return texture[min(max(row, 0), height - 1), min(max(column, 0), width - 1)]

    top = texel(0, 0) + (texel(1, 0) - texel(0, 0)) * tx
    bottom = texel(0, 1) + (texel(1, 1) - texel(0, 1)) * tx
    return top + (bottom - top) * ty


def awkward_coordinates(rng, count) -> np.ndarray:
    special = [0, -0.0, 1, -1, 0.5, np.nextafter(np.float32(1), np.float32(0)), 1e-45, -1e-45, -1e-9, 3.4e38, -3.4e38, 8388608.5]
    return np.concatenate(
        [
            rng.normal(0, 2, (count, 2)),
            rng.choice([*special, np.nan, np.inf], (count, 2)),
            rng.integers(-20, 21, (count, 2)) / 8,
        ]
    ).astype(np.float32)


SHAPES = [(1, 1, 3), (5, 7, 3), (8, 8, 1), (1, 9, 4)]


@pytest.mark.parametrize("wrap", ["repeat", "clamp"])
@pytest.mark.parametrize("how", ["nearest", "bilinear"])
def test_reference_is_the_specification(how, wrap):
    rng = np.random.default_rng(0)
    for shape in SHAPES:
        texture, uv = rng.normal(size=shape).astype(np.float32), awkward_coordinates(rng, 60)
        expected = np.array([by_the_specification(texture, u, v, how, wrap) for u, v in uv], np.float32)
        assert sample_texture(texture, uv, filter=how, wrap=wrap, backend="reference").tobytes() == expected.tobytes()


@needs_native
@pytest.mark.parametrize("wrap", ["repeat", "clamp"])
@pytest.mark.parametrize("how", ["nearest", "bilinear"])
def test_backends_agree_in_bits(how, wrap):
    rng = np.random.default_rng(1)
    for shape in SHAPES:
        texture, uv = rng.normal(size=shape).astype(np.float32), awkward_coordinates(rng, 3000)
        one, two = (sample_texture(texture, uv, filter=how, wrap=wrap, backend=backend) for backend in ("reference", "native"))
        assert one.tobytes() == two.tobytes()


def codes(rng, dtype, *shape) -> np.ndarray:
    return rng.integers(0, np.iinfo(dtype).max + 1, shape).astype(dtype)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("how", ["nearest", "bilinear"])
def test_codes_are_read_as_what_they_stand_for(how, dtype):
    rng = np.random.default_rng(2)
    for shape in SHAPES:
        texture, uv = codes(rng, dtype, *shape), awkward_coordinates(rng, 60)
        for wrap in ("repeat", "clamp"):
            result = sample_texture(texture, uv, filter=how, wrap=wrap, backend="reference")
            decoded = sample_texture(decode_srgb(texture), uv, filter=how, wrap=wrap, backend="reference")
            assert result.dtype == np.float32 and result.tobytes() == decoded.tobytes()


@needs_native
@pytest.mark.parametrize("isa", native.isa_levels() if native.available() else [])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_backends_agree_in_bits_on_codes(dtype, isa):
    rng = np.random.default_rng(3)
    for shape in SHAPES:
        texture, uv = codes(rng, dtype, *shape), awkward_coordinates(rng, 500)
        for how, wrap in itertools.product(("nearest", "bilinear"), ("repeat", "clamp")):
            one = sample_texture(texture, uv, filter=how, wrap=wrap, backend="reference")
            with native.using_isa(isa):
                two = sample_texture(texture, uv, filter=how, wrap=wrap, backend="native")
            assert one.tobytes() == two.tobytes()


@needs_native
@pytest.mark.parametrize("isa", native.isa_levels() if native.available() else [])
@pytest.mark.parametrize("dtype", [np.float32, np.uint8, np.uint16])
def test_any_number_of_lookups_and_channels(dtype, isa):
    """Lookups are taken many at a time, and some numbers of channels as one vector, which must not write past the result."""
    rng = np.random.default_rng(4)
    for count, channels in itertools.product((1, 2, 15, 17, 63, 64, 65, 129), (1, 2, 3, 4, 5)):
        texture, uv = (100 * rng.random((3, 5, channels))).astype(dtype), rng.random((count, 2)).astype(np.float32)
        expected = sample_texture(texture, uv, backend="reference")
        memory = torch.full((count + 1, channels), -7.0)
        with native.using_isa(isa):
            sample_texture(texture, uv, backend="native", out=memory[:count])
        assert memory[:count].numpy().tobytes() == expected.tobytes()
        assert (memory[count] == -7).all()


@needs_native
@pytest.mark.parametrize("how", ["nearest", "bilinear"])
@pytest.mark.parametrize("channels", [3, 4])
def test_a_texture_whose_values_32_bits_do_not_number(channels, how):
    """Its corners; what lies between them is never touched, and takes no memory."""
    texture = np.zeros((2**14 + 1, 2**15, channels), np.uint8)
    texture[0, 0], texture[-1, -1] = range(10, 10 + channels), range(200, 200 + channels)
    found = sample_texture(texture, np.array([(0, 1), (1, 0)], np.float32), filter=how, wrap="clamp", backend="native")
    assert np.array_equal(found, decode_srgb(texture[[0, -1], [0, -1]]))


def every_code(dtype) -> tuple[np.ndarray, np.ndarray]:
    """A square texture of all codes, in their order, and the coordinates of its texels."""
    side = 1 << (4 * np.dtype(dtype).itemsize)
    rows, columns = np.mgrid[:side, :side].astype(np.float32) + np.float32(0.5)
    uv = np.stack([columns / side, 1 - rows / side], axis=-1)
    return np.arange(side * side, dtype=dtype).reshape(side, side, 1), uv


@needs_native
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_every_code_is_what_the_table_has(dtype):
    texture, uv = every_code(dtype)
    wanted = decode_srgb(texture)
    assert sample_texture(texture, uv, filter="nearest", backend="native").tobytes() == wanted.tobytes()
    assert sample_texture(texture, uv, backend="native").tobytes() == wanted.tobytes()  # at the centres of texels


@pytest.mark.parametrize("backend", BACKENDS)
def test_the_same_codes_of_8_and_of_16_bits(backend):
    texture, uv = codes(np.random.default_rng(4), np.uint8, 9, 7, 3), awkward_coordinates(np.random.default_rng(5), 200)
    narrow, wide = (sample_texture(t, uv, backend=backend) for t in (texture, texture.astype(np.uint16) * 257))
    assert narrow.tobytes() == wide.tobytes() and len(np.unique(narrow)) > 100


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_codes_come_as_arrays_of_any_kind(dtype, backend):
    rng = np.random.default_rng(6)
    texture, uv = codes(rng, dtype, 6, 8, 3), rng.random((2, 5, 4, 2), np.float32)
    wanted = sample_texture(texture, uv, backend=backend)
    out, read_only = np.empty((2, 5, 4, 3), np.float32), texture.copy()
    read_only.flags.writeable = False
    assert sample_texture(read_only, uv, backend=backend, out=out) is not None and np.array_equal(out, wanted)
    assert np.array_equal(sample_texture(np.asfortranarray(texture), uv, backend=backend), wanted)
    tensor = sample_texture(torch.from_numpy(texture), torch.from_numpy(uv), backend=backend)
    assert isinstance(tensor, torch.Tensor) and np.array_equal(tensor.numpy(), wanted)


@pytest.mark.filterwarnings("ignore:.* requires grad, but nothing")
def test_shapes_and_kinds():
    texture = torch.rand(4, 6, 3, requires_grad=True)
    result = sample_texture(texture, torch.rand(2, 3, 5, 2))
    assert result.shape == (2, 3, 5, 3) and not result.requires_grad
    assert sample_texture(texture, np.zeros(2, np.float32)).shape == (3,)
    assert sample_texture(texture, torch.zeros(0, 2)).shape == (0, 3)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_channels_first_are_warned_of_once(channels, backend, monkeypatch):
    monkeypatch.setattr(warn, "_said", set())
    picture, uv = np.ones((channels, 16, 20), np.float32), np.zeros((2, 2), np.float32)
    with pytest.warns(UserWarning) as said:
        for _ in range(2):
            assert (sample_texture(picture, uv, backend=backend) == np.ones((2, 20))).all()
    assert [Path(one.filename) for one in said] == [Path(__file__)]
    text = rf"texture \[{channels}, 16, 20\] is read as \[Ht, Wt, C\]: {channels} px high, of 20 channels; .*permute"
    assert re.match(r"bigtri.sample_texture: " + text, str(said[0].message))


@pytest.mark.parametrize("shape", [(3, 20, 15), (4, 15, 20), (1, 256, 8), (2, 64, 64), (16, 20, 3), (3, 300, 3)])
def test_textures_of_few_rows_or_many_channels_are_none_of_these(shape, monkeypatch):
    monkeypatch.setattr(warn, "_said", set())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sample_texture(np.ones(shape, np.float32), np.zeros((2, 2), np.float32))


@pytest.mark.parametrize(
    ("change", "error", "text"),
    [
        ({"texture": FOUR[..., 0]}, ValueError, r"texture must be float32, uint8 or uint16 \[Ht, Wt, C\], got float32 \[2, 2\]"),
        ({"texture": FOUR.astype(np.int8)}, TypeError, "texture must be float32, uint8 or uint16 .*, got int8"),
        ({"texture": FOUR.astype(">u2")}, TypeError, "texture must be float32, uint8 or uint16 .*, got >u2"),
        (
            {"texture": torch.ones(2, 2, 1, dtype=torch.int32)},
            TypeError,
            "texture must be float32, uint8 or uint16 .*, got int32",
        ),
        ({"texture": [1, 2]}, TypeError, r"texture must be a torch tensor or a NumPy array, float32, uint8 or uint16 \[Ht,"),
        ({"texture": FOUR[:0]}, ValueError, "texture must have at least one texel"),
        ({"uv": np.zeros((3, 3), np.float32)}, ValueError, "uv must have size 2"),
        ({"uv": np.zeros((3, 2))}, TypeError, "uv must be float32"),
        ({"filter": "linear"}, ValueError, "filter must be one of 'bilinear', 'nearest', got 'linear'"),
        ({"wrap": "mirror"}, ValueError, "wrap must be one of"),
    ],
)
def test_errors_name_the_argument(change, error, text):
    with pytest.raises(error, match="bigtri.sample_texture: " + text):
        sample_texture(**{"texture": FOUR, "uv": np.zeros((3, 2), np.float32), **change})
