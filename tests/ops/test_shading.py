"""sRGB against exact arithmetic, Lambert by hand and by a scalar model, and backend against backend."""

from decimal import Decimal, getcontext
from fractions import Fraction

import numpy as np
import pytest
import torch
from backends import BACKENDS, needs_native
from exhaustive import some_of

from bigtri import decode_srgb, encode_srgb, lambert
from bigtri.reference.shading import _wide_decode_table, decode_table, encode_thresholds

CODES = np.arange(256, dtype=np.uint8)


def transfer(encoded: Fraction) -> Fraction:
    """The sRGB transfer function to 60 digits, by exponential and logarithm."""
    getcontext().prec = 60
    value = Decimal(encoded.numerator) / Decimal(encoded.denominator)
    if value <= Decimal("0.04045"):
        return Fraction(value / Decimal("12.92"))
    return Fraction((((value + Decimal("0.055")) / Decimal("1.055")).ln() * Decimal("2.4")).exp())


def is_nearest(value: np.float32, exact: Fraction) -> bool:
    below, above = np.nextafter(value, np.float32(-9)), np.nextafter(value, np.float32(9))
    error = abs(Fraction(float(value)) - exact)
    return all(error <= abs(Fraction(float(other)) - exact) for other in (below, above))


def test_tables_are_correctly_rounded():
    decoded = decode_srgb(CODES)
    assert all(is_nearest(value, transfer(Fraction(code, 255))) for code, value in enumerate(decoded))
    assert all(is_nearest(value, transfer(Fraction(2 * k + 1, 510))) for k, value in enumerate(encode_thresholds()))
    assert decoded[0] == 0 and decoded[255] == 1
    assert decoded.dtype == np.float32


@pytest.mark.parametrize("codes", some_of([range(0, 65536, 97)], [range(0, 65536, 97), range(65536)]), ids=len)
def test_the_table_of_16_bits_is_correctly_rounded(codes):
    decoded = decode_srgb(np.arange(65536, dtype=np.uint16))
    assert decoded.dtype == np.float32
    assert all(is_nearest(decoded[code], transfer(Fraction(code, 65535))) for code in codes)
    assert decoded[::257].tobytes() == decode_srgb(CODES).tobytes()


def test_what_float64_leaves_open_is_worked_out():
    # With so large a doubt some 90 codes are.
    assert _wide_decode_table(2.0**-34).tobytes() == decode_table(16).tobytes()


@pytest.mark.parametrize("backend", BACKENDS)
def test_encoding_rounds_to_the_nearest_code(backend):
    assert np.array_equal(encode_srgb(decode_srgb(CODES), backend=backend), CODES)
    thresholds = encode_thresholds()
    assert np.array_equal(encode_srgb(thresholds.copy(), backend=backend), CODES[1:])
    assert np.array_equal(encode_srgb(np.nextafter(thresholds, np.float32(0)), backend=backend), CODES[:-1])
    extremes = np.array([np.nan, -np.inf, -1, -0.0, 1e-45, 2, np.inf], np.float32)
    assert encode_srgb(extremes, backend=backend).tolist() == [0, 0, 0, 0, 0, 255, 255]


@pytest.mark.parametrize("backend", BACKENDS)
def test_lambert_by_hand(backend):
    normals = np.array([(0, 0, 2), (0, 0, -3), (3, 0, 4), (0, 0, 0), (np.inf, 0, 0), (3e38, 3e38, 0)], np.float32)
    albedo = np.full((6, 3), 0.5, np.float32)
    result = lambert(
        normals,
        albedo,
        np.array((0.25, 0.5, 0.75), np.float32),
        np.array([(0, 0, 1), (1, 0, 0)], np.float32),
        np.array([(1, 1, 1), (0.5, 0, 0)], np.float32),
        backend=backend,
    )
    ambient = [0.125, 0.25, 0.375]
    assert result[0].tolist() == [0.625, 0.75, 0.875]  # straight into the first light
    assert result[1].tolist() == ambient  # away from it
    np.testing.assert_allclose(result[2], [0.125 + 0.5 * (0.8 + 0.3), 0.25 + 0.4, 0.375 + 0.4], rtol=1e-6)
    assert result[3:].tolist() == [ambient] * 3  # normals without a direction


def by_the_specification(n, albedo, ambient, directions, colors):
    """docs/numerics.md section 11 for one point, in scalars."""
    s = (n[0] * n[0] + n[1] * n[1]) + n[2] * n[2]
    usable = np.isfinite(s) and s != 0
    x, y, z = (c / np.sqrt(s) if usable else np.float32(0) for c in n)
    c = list(ambient)
    for d, light in zip(directions, colors, strict=True):
        facing = (x * d[0] + y * d[1]) + z * d[2]
        facing = facing if facing > 0 else np.float32(0)
        c = [c[i] + light[i] * facing for i in range(3)]
    return [albedo[i] * c[i] for i in range(3)]


def awkward_lambert(rng, count) -> tuple[np.ndarray, ...]:
    special = [0, -0.0, 1, 1e19, 3e38, 1e-23, 1e-45, -2, np.nan]
    normals = np.concatenate([rng.normal(size=(count, 3)), rng.choice(special, (count, 3))])
    albedo = rng.choice([0, -0.0, 0.3, 1, 2], (2 * count, 3))
    lights = rng.normal(size=(3, 3)), rng.choice([0, -0.0, 0.7, -0.4], (3, 3))
    return tuple(a.astype(np.float32) for a in (normals, albedo, np.array((0.1, 0, -0.0)), *lights))


@pytest.mark.filterwarnings("ignore:overflow", "ignore:invalid")
def test_reference_is_the_specification():
    arguments = awkward_lambert(np.random.default_rng(0), 300)
    normals, albedo, *rest = arguments
    expected = np.array([by_the_specification(n, a, *rest) for n, a in zip(normals, albedo, strict=True)], np.float32)
    assert lambert(*arguments, backend="reference").tobytes() == expected.tobytes()


@needs_native
def test_backends_agree_in_bits():
    rng = np.random.default_rng(1)
    normals, albedo, ambient, directions, colors = awkward_lambert(rng, 4000)
    for lights in (0, 1, 3):
        arguments = (normals, albedo, ambient, directions[:lights], colors[:lights])
        one, two = (lambert(*arguments, backend=backend) for backend in ("reference", "native"))
        assert one.tobytes() == two.tobytes()
    linear = rng.normal(0.5, 0.6, (70, 31, 3)).astype(np.float32)
    assert np.array_equal(*(encode_srgb(linear, backend=backend) for backend in ("reference", "native")))


def test_shapes_and_kinds():
    normals = torch.randn(2, 5, 7, 3, requires_grad=True)
    result = lambert(normals, torch.ones(2, 5, 7, 3), torch.ones(3), torch.zeros(0, 3), torch.zeros(0, 3))
    assert result.shape == (2, 5, 7, 3) and not result.requires_grad and bool((result == 1).all())
    assert encode_srgb(result).dtype == torch.uint8
    assert decode_srgb(encode_srgb(result)).shape == result.shape


def test_errors_name_the_argument():
    three, points = torch.ones(3), torch.ones(4, 3)
    with pytest.raises(ValueError, match=r"bigtri.lambert: albedo must have normals' shape \[4, 3\], got \[1, 3\]"):
        lambert(points, torch.ones(1, 3), three, points, points)
    with pytest.raises(ValueError, match="bigtri.lambert: light_colors must have size 4"):
        lambert(points, points, three, points, points[:2])
    with pytest.raises(TypeError, match="bigtri.lambert: ambient must be float32"):
        lambert(points, points, three.double(), points, points)
    with pytest.raises(TypeError, match="bigtri.encode_srgb: linear must be float32"):
        encode_srgb(three.half())
    with pytest.raises(TypeError, match="bigtri.decode_srgb: encoded must be uint8 or uint16"):
        decode_srgb(three)
