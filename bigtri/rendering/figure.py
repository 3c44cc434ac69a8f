"""Small drawing helpers for ``views``: tints, labels and legends on uint8 [H, W, 3] images."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Color = tuple[int, int, int]
Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]

_TEXT: Color = (240, 243, 248)
_PANEL: Color = (16, 20, 30)


def save(path: Path, image: Image) -> Path:
    """Writes a picture uint8 [H, W, 3] in the format that the file's name says; returns the path.

    Raises:
        OSError: the file cannot be written.
    """
    from skimage import io

    io.imsave(path, image, check_contrast=False)
    return path


def save_animation(path: Path, images: Sequence[Image], seconds: float) -> Path:
    """Writes pictures uint8 [H, W, 3 or 4] one after the other, over and over, as .gif, .webp or .apng; returns the path.

    Args:
        seconds: for which each is shown; a GIF has hundredths.

    Raises:
        OSError: the file cannot be written.
    """
    import PIL.Image

    kind = path.suffix.lower().removeprefix(".")
    # A GIF has 256 colours, and draws over the picture before unless that is disposed of.
    by_kind: dict[str, dict[str, Any]] = {"gif": {"disposal": 2}, "webp": {"lossless": True}}
    first, *others = (PIL.Image.fromarray(np.ascontiguousarray(image)) for image in images)
    milliseconds = 10 * max(1, round(100 * seconds)) if kind == "gif" else round(1000 * seconds)
    name = "PNG" if kind == "apng" else None
    first.save(path, name, save_all=True, append_images=others, duration=milliseconds, loop=0, **by_kind.get(kind, {}))
    return path


def ramp(stops: NDArray[np.float64], value: NDArray[np.float64]) -> NDArray[np.float64]:
    """Colours [..., 3] along ``stops`` [S, 3], which are equally far apart, at value [...] in [0, 1]."""
    place = np.linspace(0, 1, len(stops))
    return np.stack([np.interp(value, place, stops[:, i]) for i in range(3)], axis=-1)


def faint(image: Image | None, shape: tuple[int, int], background: Color) -> Image:
    """The image in dark greys, or a plain ``background`` where there is none."""
    if image is None:
        return np.full((*shape, 3), background, np.uint8)
    grey = image @ np.array([0.3, 0.59, 0.11])
    return np.repeat(np.rint(18 + 0.42 * grey)[..., None], 3, axis=-1).astype(np.uint8)


def tint(image: Image, where: Mask, color: Color, strength: float) -> Image:
    """``color`` blended over the image by ``strength`` where the mask is set."""
    mixed = image * (1 - strength) + np.array(color) * strength
    return np.where(where[..., None], np.rint(mixed), image).astype(np.uint8)


def grow(cells: Mask, size: int, shape: tuple[int, int]) -> Mask:
    """The mask of squares of ``size`` px as a mask of pixels, cut to ``shape`` (height, width)."""
    return np.repeat(np.repeat(cells, size, axis=0), size, axis=1)[: shape[0], : shape[1]]


def inside(shape: tuple[int, int], size: int) -> Mask:
    """All pixels but the first row and the first column of each square of ``size`` px."""
    return (np.arange(shape[0]) % size != 0)[:, None] & (np.arange(shape[1]) % size != 0)[None, :]


def polygon(image: Image, points: Sequence[tuple[float, float]], color: Color, width: int) -> Image:
    """A closed line through ``points``, px."""
    canvas, draw = _canvas(image)
    draw.line([*points, points[0]], fill=color, width=width)
    return np.asarray(canvas)


def labelled_bins(image: Image, used: NDArray[np.int64], considered: NDArray[np.int64], size: int) -> Image:
    """ "used/considered" in the upper left corner of each bin that is considered at all."""
    canvas, draw = _canvas(image)
    font = _font(11)
    for row, column in np.argwhere(considered > 0).tolist():
        text = f"{used[row, column]}/{considered[row, column]}"
        draw.text((column * size + 4, row * size + 3), text, fill=_TEXT, font=font, stroke_width=1, stroke_fill=_PANEL)
    return np.asarray(canvas)


def with_legend(image: Image, entries: Sequence[tuple[Color, str]]) -> Image:
    """A panel at the lower left with a coloured square and a line of text per entry."""
    canvas, draw = _canvas(image)
    size = _text_size(image)
    font, line, margin = _font(size), round(1.5 * size), size
    width = round(max(draw.textlength(text, font=font) for _, text in entries)) + 2 * size + 2 * margin
    top = image.shape[0] - line * len(entries) - 2 * margin
    draw.rectangle((0, top, width, image.shape[0]), fill=_PANEL)
    for i, (color, text) in enumerate(entries):
        y = top + margin + i * line
        draw.rectangle((margin, y, margin + size, y + size), fill=color, outline=_TEXT)
        draw.text((margin + 2 * size, y + size / 2), text, fill=_TEXT, font=font, anchor="lm")
    return np.asarray(canvas)


def with_color_bar(image: Image, stops: NDArray[np.float64], top: int, title: str) -> Image:
    """A panel along the lower edge with the colours of 1 to ``top`` and a title."""
    canvas, draw = _canvas(image)
    height, width = image.shape[:2]
    size = _text_size(image)
    font, margin = _font(size), size
    panel = 4 * size + 2 * margin
    # A picture may be narrower than its margins.
    length = max(1, min(width - 2 * margin, round(max(draw.textlength(title, font=font), 24 * size))))
    draw.rectangle((0, height - panel, length + 2 * margin, height), fill=_PANEL)
    y = height - panel + margin
    draw.text((margin, y), title, fill=_TEXT, font=font)
    # One block per count while they can be told apart; then a smooth bar.
    blocks = top if top <= min(32, length) else length
    edges = np.rint(np.linspace(0, length, blocks + 1)).astype(int)
    shown = np.arange(1, blocks + 1) / blocks
    for left, right, color in zip(edges[:-1], edges[1:], np.rint(ramp(stops, shown)).astype(int), strict=True):
        draw.rectangle((margin + left, y + 1.5 * size, margin + right - 1, y + 2.7 * size), fill=tuple(color.tolist()))
    every = -(-top // 12)
    for count in sorted({1, top, *range(every, top - every // 2, every)}):
        x = margin + (count - 0.5) * length / top
        draw.text((x, y + 3 * size), str(count), fill=_TEXT, font=font, anchor="ma")
    return np.asarray(canvas)


def _text_size(image: Image) -> int:
    return max(9, round(image.shape[0] / 60))


def _canvas(image: Image) -> tuple[Any, Any]:
    import PIL.Image
    from PIL import ImageDraw

    canvas = PIL.Image.fromarray(np.ascontiguousarray(image))
    return canvas, ImageDraw.Draw(canvas)


def _font(size: int) -> Any:
    from PIL import ImageFont

    return ImageFont.load_default(size)
