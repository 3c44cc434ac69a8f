"""What the tests of OBJ, PLY, STL and OFF share: files written, read, and looked at from (0, 0, 3)."""

import importlib
import warnings
from pathlib import Path

import bigtri
from bigtri import Camera, render
from bigtri.scene.readers.assemble import assemble

# The corners of a square, as lines of an OBJ file or of a body in ASCII, and its texture coordinates.
SQUARE = "-1 -1 0\n1 -1 0\n1 1 0\n-1 1 0\n"
# In a picture from (0, 0, 3) of 64 x 64 px, the square is seen in so many.
SQUARE_PIXELS = 52 * 52


def write(folder: Path, name: str, content: str | bytes) -> Path:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def read(path: Path):
    """The model of a file, by the reader of its ending; no warning on the way."""
    reader = importlib.import_module(f"bigtri.scene.readers.{path.suffix[1:]}")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return reader.read(path)


def scene_of(path: Path, *findings: str):
    """The scene of a file that has these kinds of findings and no others."""
    model = read(path)
    made = assemble(model)
    assert tuple(model.findings) == findings, model.findings
    return made


def seen(scene):
    """The buffers of a picture from (0, 0, 3)."""
    return render(scene, Camera((0, 0, 3), (0, 0, 0)), (64, 64), return_buffers=True)[1]


def pixels(scene) -> int:
    return int((seen(scene).visibility.triangle >= 0).sum())


def quarter_colors(scene):
    """sRGB codes in the middle of the four quarters of the square, upper left and right, lower left and right."""
    albedo = bigtri.encode_srgb(seen(scene).albedo)
    return [tuple(albedo[y, x].tolist()) for y, x in ((24, 24), (24, 40), (40, 24), (40, 40))]


def middle_color(scene):
    """Linear light in the middle of the picture."""
    return seen(scene).albedo[32, 32].tolist()
