"""Image files to the sRGB codes of a texture, through Pillow."""

from __future__ import annotations

import io
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..reference.numerics import MAX_TEXTURE
from .readers.model import ModelError

if TYPE_CHECKING:
    from PIL import ImageFile

# Of colours of 16 bits Pillow keeps the upper 8. It decodes the lower 8 as well if it is told that the file has its bytes in
# the other order: for the raw mode of a PNG, that of its upper bytes and where they are, then the same of its lower bytes.
_BYTES_OF_16_BITS = {
    "RGB;16B": (("RGB;16B", (0, 1, 2)), ("RGB;16L", (0, 1, 2))),
    "RGBA;16B": (("RGBA;16B", (0, 1, 2)), ("RGBA;16L", (0, 1, 2))),
    "LA;16B": (("RGBA", (0, 0, 0)), ("RGBA", (1, 1, 1))),  # upper and lower byte of the grey, then those of alpha
}


def read_image(source: Path | bytes, what: str) -> NDArray[Any]:
    """The colours of an image file, as they are stored.

    Alpha is left out, and nothing is blended with it. Grey, palettes and CMYK become red, green and blue. Gamma and colour
    profiles are not applied. Neither is an orientation in the EXIF data, as glTF wants it; only that of a TIFF is, where it is
    part of the format. Of an animation the first picture is read. All 16 bits are kept of grey and of PNG, else the upper 8.

    Args:
        source: a file, or its bytes, in any format that Pillow reads: PNG, JPEG and WebP among them.
        what: names the image for the error text.

    Returns:
        sRGB codes [Ht, Wt, 3], row 0 on top: uint8, or uint16 of an image of 16 bits.

    Raises:
        ModelError: the image is missing, broken or of 32 bits, or too large: more than 65536 px a side, or than twice
            ``PIL.Image.MAX_IMAGE_PIXELS``, which is 178,956,970 px unless it is set. One line that begins with ``what``.
    """
    from PIL import Image, UnidentifiedImageError

    try:
        # Of Pillow's warnings, one is of images of half the limit, the others of details that textures do not have.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return _codes(source)
    except ModelError as error:
        raise ModelError(f"{what}: {error}") from None
    except Image.DecompressionBombError as error:
        too_large = str(error).partition(",")[0]  # the number of pixels, and the limit
        raise ModelError(f"{what}: {too_large}: set PIL.Image.MAX_IMAGE_PIXELS to half of what is needed") from error
    except UnidentifiedImageError as error:
        raise ModelError(f"{what}: the image must be of a format that Pillow reads, such as PNG, JPEG or WebP") from error
    except Exception as error:  # a broken image breaks Pillow in any way
        raise ModelError(f"{what}: the image cannot be read: {_reason(error)}") from error


def _codes(source: Path | bytes) -> NDArray[Any]:
    with _opened(source) as image:
        if max(image.size) > MAX_TEXTURE:
            width, height = image.size
            raise ModelError(f"the image must have at most {MAX_TEXTURE} px a side, got {width} x {height}")
        raw_mode = image.tile[0][3] if image.tile else None
        if image.format == "PNG" and raw_mode in _BYTES_OF_16_BITS:
            upper, lower = (_decoded(source, *part).astype(np.uint16) for part in _BYTES_OF_16_BITS[raw_mode])
            return (upper << 8) | lower
        # Of 16 bits, "I" (32 bits) is what some releases of Pillow have for PNG, and all have for PGM.
        if image.mode.startswith("I"):
            grey = np.array(image)
            if grey.min() < 0 or grey.max() > 65535:
                raise ModelError(f"the image must have 8 or 16 bits, got values from {grey.min()} to {grey.max()}")
            return np.repeat(grey.astype(np.uint16)[..., None], 3, axis=2)
        if image.mode == "F":
            raise ModelError("the image must have 8 or 16 bits, got 32-bit floating point")
        return np.array(image.convert("RGB"))


def _opened(source: Path | bytes) -> ImageFile.ImageFile:
    from PIL import Image

    return Image.open(io.BytesIO(source) if isinstance(source, bytes) else source)


def _decoded(source: Path | bytes, raw_mode: str, channels: tuple[int, ...]) -> NDArray[np.uint8]:
    """uint8 [Ht, Wt, channels] of a PNG, its bytes taken as ``raw_mode`` says."""
    with _opened(source) as image:
        image.tile = [(*where, raw_mode) for *where, _ in image.tile]  # type: ignore[misc]
        return np.array(image)[..., channels]


def _reason(error: Exception) -> str:
    """What an error says, in one line; its kind, where it says nothing."""
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return " ".join(text.split()) or type(error).__name__
