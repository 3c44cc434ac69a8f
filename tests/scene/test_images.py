"""Images of every kind, made in memory, and the codes that are in them."""

import io
import struct
import warnings
import zlib

import numpy as np
import pytest
from PIL import Image

from bigtri.scene.images import read_image
from bigtri.scene.readers.model import ModelError

# Red, green above blue, white above two colours of which every channel is its own.
COLORS = np.array([[(255, 0, 0), (0, 255, 0)], [(0, 0, 255), (255, 255, 255)], [(10, 100, 200), (77, 88, 99)]], np.uint8)
GREY = np.array([(0, 255, 128), (1, 2, 77)], np.uint8)
ALPHA = np.array([(0, 1, 128), (255, 2, 9)], np.uint8)  # of GREY
WIDE = np.array([(0, 65535, 257), (1, 256, 40000)], np.uint16)


def png(image: Image.Image, **settings) -> bytes:
    file = io.BytesIO()
    image.save(file, "PNG", **settings)
    return file.getvalue()


def raw_png(width: int, height: int, depth: int, kind: int, rows: list[bytes]) -> bytes:
    """A PNG file; depth: bits; kind: 0 grey, 2 RGB, 4 grey and alpha, 6 RGBA; rows: each after the byte that names its filter."""
    header = struct.pack(">IIBBBBB", width, height, depth, kind, 0, 0, 0)
    parts = ((b"IHDR", header), (b"IDAT", zlib.compress(b"".join(rows))), (b"IEND", b""))
    chunks = (struct.pack(">I", len(p)) + name + p + struct.pack(">I", zlib.crc32(name + p)) for name, p in parts)
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


def png_of_16_bits(codes: np.ndarray, kind: int) -> bytes:
    """A PNG file of uint16 [H, W, C]; kind as in ``raw_png``. Of every pixel the difference to that on its left is stored."""
    height, width, channels = codes.shape
    stored = codes.astype(">u2").view(np.uint8).reshape(height, width, 2 * channels)
    stored[:, 1:] = stored[:, 1:] - stored[:, :-1]
    return raw_png(width, height, 16, kind, [b"\1" + row.tobytes() for row in stored])


def threefold(grey: np.ndarray) -> np.ndarray:
    return np.stack([grey] * 3, axis=2)


def palette(**settings) -> bytes:
    image = Image.fromarray(np.array([(0, 1), (2, 3), (4, 5)], np.uint8), "P")
    image.putpalette(COLORS.reshape(-1).tolist())
    return png(image, **settings)


def with_alpha(values: np.ndarray, alpha: np.ndarray) -> bytes:
    return png(Image.fromarray(np.concatenate([np.atleast_3d(values), alpha[..., None]], axis=2)))


def saved(format: str, image: Image.Image, **settings) -> bytes:
    file = io.BytesIO()
    image.save(file, format, **settings)
    return file.getvalue()


RGB = Image.fromarray(COLORS)
CMYK = np.array([[(0, 0, 0, 0), (0, 255, 255, 0)], [(0, 0, 0, 255), (255, 255, 0, 0)]], np.uint8)
MODES = {
    "RGB": (png(RGB), COLORS),
    "RGBA, as stored, also where nothing is to be seen": (with_alpha(COLORS, np.zeros((3, 2), np.uint8)), COLORS),
    "grey": (png(Image.fromarray(GREY)), threefold(GREY)),
    "grey and alpha": (with_alpha(GREY, ALPHA), threefold(GREY)),
    "1 bit": (png(Image.fromarray(GREY > 100)), threefold(np.array([(0, 255, 255), (0, 0, 0)], np.uint8))),
    "4 bits": (raw_png(2, 2, 4, 0, [b"\0\x0f", b"\0\x36"]), threefold(np.array([(0, 255), (51, 102)], np.uint8))),
    "palette": (palette(), COLORS),
    "palette with one colour transparent": (palette(transparency=3), COLORS),
    "palette with an alpha for each colour": (palette(transparency=bytes([0, 1, 128, 200, 254, 255])), COLORS),
    "CMYK": (saved("TIFF", Image.fromarray(CMYK, "CMYK")), [[(255, 255, 255), (255, 0, 0)], [(0, 0, 0), (0, 0, 255)]]),
    "WebP": (saved("WEBP", RGB, lossless=True), COLORS),
    "GIF, its first picture": (
        saved("GIF", RGB.quantize(), save_all=True, append_images=[RGB.transpose(Image.Transpose.ROTATE_180).quantize()]),
        COLORS,
    ),
    "16 bits of grey": (png(Image.fromarray(WIDE)), threefold(WIDE)),
    "16 bits of grey, big-endian": (
        saved("TIFF", Image.frombytes("I;16B", (3, 2), WIDE.astype(">u2").tobytes())),
        threefold(WIDE),
    ),
    "16 bits of grey, as 32": (saved("TIFF", Image.fromarray(WIDE.astype(np.int32))), threefold(WIDE)),
}


@pytest.mark.parametrize("name", MODES)
def test_the_codes_are_those_of_the_file(name, tmp_path):
    data, wanted = MODES[name]
    (tmp_path / "image").write_bytes(data)
    for source in (data, tmp_path / "image"):
        codes = read_image(source, name)
        assert codes.dtype == (np.uint16 if name.startswith("16") else np.uint8)
        assert np.array_equal(codes, wanted)
        assert codes.flags.writeable and codes.flags.c_contiguous  # a texture that is not would be copied


@pytest.mark.parametrize(("kind", "channels"), [(0, 1), (2, 3), (4, 2), (6, 4)])
def test_16_bits_of_a_png_are_kept(kind, channels):
    codes = np.random.default_rng(kind).integers(0, 65536, (5, 7, channels)).astype(np.uint16)
    read = read_image(png_of_16_bits(codes, kind), "deep")
    assert read.dtype == np.uint16
    assert np.array_equal(read, codes[..., :3] if channels > 2 else threefold(codes[..., 0]))


@pytest.mark.parametrize("mode", ["RGB", "L", "CMYK"])
def test_a_jpeg_is_near_what_was_saved(mode):
    colors = np.full((16, 16, 3), (200, 120, 40), np.uint8)
    image = Image.fromarray(colors).convert(mode)
    read = read_image(saved("JPEG", image, quality=100), "photo").astype(int)
    # JPEG rounds; the same picture upside down or with its colours inverted would be far off.
    assert np.abs(read - np.array(image.convert("RGB"), int)).max() <= 3


def test_an_orientation_is_not_applied():
    exif = Image.Exif()
    exif[0x0112] = 6  # to be turned by a quarter
    for format, settings in (("PNG", {}), ("WEBP", {"lossless": True})):
        assert np.array_equal(read_image(saved(format, RGB, exif=exif, **settings), "turned"), COLORS)
    assert read_image(saved("JPEG", RGB, exif=exif), "turned").shape == COLORS.shape


def test_too_many_pixels_are_said(monkeypatch):
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 50)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read_image(png(Image.new("RGB", (10, 10))), "atlas").shape == (10, 10, 3)
    wanted = r"^atlas: Image size \(110 pixels\) exceeds limit of 100 pixels: set PIL.Image.MAX_IMAGE_PIXELS to half"
    with pytest.raises(ModelError, match=wanted):
        read_image(png(Image.new("RGB", (11, 10))), "atlas")
    with pytest.raises(ModelError, match="^strip: the image must have at most 65536 px a side, got 65537 x 1$"):
        monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", None)
        read_image(png(Image.new("L", (65537, 1))), "strip")


def test_the_limit_is_what_the_docstring_says():
    assert Image.MAX_IMAGE_PIXELS is not None and f"{2 * Image.MAX_IMAGE_PIXELS:,}" in (read_image.__doc__ or "")


def test_what_is_broken_is_one_line(tmp_path):
    whole = png(Image.fromarray(np.random.default_rng(0).integers(0, 256, (30, 30, 3)).astype(np.uint8)))
    damaged = whole[:60] + bytes(40) + whole[100:]
    deep = png_of_16_bits(np.random.default_rng(0).integers(0, 65536, (30, 30, 3)), 2)
    for source, text in (
        (b"", "of a format that Pillow reads"),
        (b"no image at all", "of a format that Pillow reads"),
        (whole[: len(whole) // 2], "cannot be read: .*truncated"),
        (deep[: len(deep) // 2], "cannot be read: .*truncated"),
        (damaged, "cannot be read: "),
        (tmp_path / "none.png", "cannot be read: No such file or directory"),
        (tmp_path, "cannot be read: "),
        (saved("TIFF", Image.fromarray(np.full((2, 2), 70000, np.int32))), "8 or 16 bits, got values from 70000 to 70000"),
        (saved("TIFF", Image.fromarray(np.ones((2, 2), np.float32))), "8 or 16 bits, got 32-bit floating point"),
    ):
        with pytest.raises(ModelError, match="^images/3 of a.glb: the image .*" + text) as said:
            read_image(source, "images/3 of a.glb")
        assert "\n" not in str(said.value) and "0x" not in str(said.value)
