"""One picture per family of hard cases: what naive float32 draws, what bigtri draws, and the pixels that differ."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..rendering import figure
from . import constructions, depths, naive
from .mesh import SUBPX, Backend, Box, Mesh, box_of, clip_space, covered, f32, positive
from .rules import soup

Image = NDArray[np.uint8]
_BACKGROUND = (30, 34, 46)
_GAP = (255, 60, 160)
_TWICE = (255, 214, 10)
_TITLE = 30  # px above each panel
_GUTTER = 12  # px between panels
# Neighbours in a fan or a mesh differ in lightness as well as in hue.
_COLORS = np.array([(66, 120, 188), (120, 190, 150), (84, 92, 160), (150, 200, 214), (48, 140, 140), (170, 160, 214)], np.uint8)


class Picture(NamedTuple):
    """Three panels of the same pixels, and what is said above and below them."""

    name: str
    titles: tuple[str, str, str]
    note: str
    draw: Callable[[Backend], tuple[Image, Image, Image]]
    zoom: int


class Drawn(NamedTuple):
    """How often each pixel of a window is covered, and by whom last."""

    times: NDArray[np.int64]
    owner: NDArray[np.int64]


def draw_all(folder: Path, progress: Callable[[str], None] = lambda line: None) -> list[Path]:
    """Write all pictures as PNG files; returns them. The folder is made if it is not there."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for picture in PICTURES:
        progress(f"drawing {picture.name}")
        paths.append(figure.save(folder / f"{picture.name}.png", sheet(picture)))
    return paths


def sheet(picture: Picture) -> Image:
    """The three panels of a picture side by side, enlarged, titled."""
    import PIL.Image
    from PIL import ImageDraw, ImageFont

    panels = [np.repeat(np.repeat(panel, picture.zoom, 0), picture.zoom, 1) for panel in picture.draw(Backend("auto"))]
    height, width = panels[0].shape[:2]
    sheet = np.full((height + 2 * _TITLE, 3 * width + 2 * _GUTTER, 3), 255, np.uint8)
    for k, panel in enumerate(panels):
        left = k * (width + _GUTTER)
        sheet[_TITLE : _TITLE + height, left : left + width] = panel
    canvas = PIL.Image.fromarray(sheet)
    draw = ImageDraw.Draw(canvas)
    for k, title in enumerate(picture.titles):
        draw.text((k * (width + _GUTTER), 6), title, fill=(20, 24, 34), font=ImageFont.load_default(15))
    draw.text((0, height + _TITLE + 6), picture.note, fill=(70, 76, 90), font=ImageFont.load_default(14))
    return np.asarray(canvas)


def _draw(mesh: Mesh, window: Box, cover: Callable[[NDArray[np.int64], Box], NDArray[np.bool_]]) -> Drawn:
    x0, y0, x1, y1 = window
    count, index = np.zeros((y1 - y0, x1 - x0), np.int64), np.full((y1 - y0, x1 - x0), -1)
    for t, xy in enumerate(mesh.xy):
        # Of the whole bounding box: stepping variants depend on where they start.
        bx0, by0, bx1, by1 = box = box_of(xy, mesh.resolution)
        cx0, cy0, cx1, cy1 = max(x0, bx0), max(y0, by0), min(x1, bx1), min(y1, by1)
        if cx0 < cx1 and cy0 < cy1:
            mask = cover(xy, box)[cy0 - by0 : cy1 - by0, cx0 - bx0 : cx1 - bx0]
            here = np.s_[cy0 - y0 : cy1 - y0, cx0 - x0 : cx1 - x0]
            count[here] += mask
            index[here] = np.where(mask, t, index[here])
    return Drawn(count, index)


def colored(index: NDArray[np.int64]) -> Image:
    """A colour for each triangle [H, W], the background where it is -1."""
    colors = _COLORS[(index + index // 7) % len(_COLORS)]
    return np.where((index >= 0)[..., None], colors, np.array(_BACKGROUND, np.uint8)).astype(np.uint8)


def marked(image: Image, missing: NDArray[np.bool_], extra: NDArray[np.bool_]) -> Image:
    """The image in dark greys, what is missing in pink, what is there and should not be in yellow."""
    faint = figure.faint(image, image.shape[:2], _BACKGROUND)
    return figure.tint(figure.tint(faint, missing, _GAP, 1.0), extra, _TWICE, 1.0)


def coverage_panels(
    build: Callable[[], list[Mesh]], variant: str, window: Box, which: int = 0
) -> Callable[[Backend], tuple[Image, Image, Image]]:
    """Panels of a mesh: gaps show the background, pixels drawn too often are yellow."""

    def draw(backend: Backend) -> tuple[Image, Image, Image]:
        x0, y0, x1, y1 = window
        mesh = build()[which]
        exact = _draw(mesh, window, covered)
        if variant == "fixed4":
            plain = _draw(mesh, window, lambda xy, box: covered(naive.fixed4(xy), box))
        else:
            plain = _draw(mesh, window, lambda xy, box: naive.coverage(variant, positive(xy), box))
        # Where triangles lie above each other by construction, the last one is shown by all.
        drawn = np.asarray(backend.draw(mesh.positions, mesh.triangles[::-1], mesh.resolution).triangle)[y0:y1, x0:x1].astype(int)
        right = colored(np.where(drawn < 0, -1, len(mesh.xy) - 1 - drawn))
        left = figure.tint(colored(plain.owner), plain.times > exact.times, _TWICE, 1.0)
        missing, extra = plain.times < exact.times, plain.times > exact.times
        return left, right, marked(right, missing, extra | ((plain.owner != exact.owner) & ~missing))

    return draw


def clip_panels(backend: Backend) -> tuple[Image, Image, Image]:
    """A floor that passes under the camera, divided by w without clipping."""
    size = (120, 160)
    floor = np.array([[-2, -1, 3], [2, -1, 3], [2, -1, -9], [-2, -1, -9]], np.float64)
    near, far = 0.1, 20.0
    z = -(floor[:, 2] * (far + near) + 2 * far * near) / (far - near)
    positions = np.stack([floor[:, 0], 1.3 * floor[:, 1], z, -floor[:, 2]], 1).astype(np.float32)
    triangles = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    drawn = np.asarray(backend.draw(positions, triangles, size).triangle).astype(int)
    middle = f32([size[1] / 2, size[0] / 2])
    screen = positions[:, :2] / positions[:, 3:] * middle * f32([1, -1]) + middle
    plain = np.full(size, -1)
    for t, triangle in enumerate(triangles):
        xy = np.rint(screen[triangle].astype(np.float64) * SUBPX).astype(np.int64)
        plain[naive.coverage("tl", positive(xy), (0, 0, size[1], size[0]))] = t
    right = colored(drawn)
    return colored(plain), right, marked(right, (plain < 0) & (drawn >= 0), (plain >= 0) & (drawn != plain))


def one_pair() -> list[Mesh]:
    """The pair of H05 with most pixel centres on its shared edge, by itself."""
    mesh = constructions.shared_edges_through_centres()[0]
    return [mesh._replace(xy=mesh.xy[18:20])]


def far_fan() -> list[Mesh]:
    """A fan from an apex 3.5 million px away whose edges cross the screen 7 px apart."""
    apex = np.array([-2_987_653, -1_876_541]) * SUBPX
    near = constructions.px(np.stack([np.arange(14) * 6.13 + 3.3, 61.7 - np.arange(14) * 4.27], -1))
    far = (near - apex) * 97 // 71 + apex  # beyond the screen, a third of the way again
    rim = far // 64 * 64  # float32 holds these
    return [Mesh(np.stack([np.broadcast_to(apex, (13, 2)), rim[:-1], rim[1:]], 1), (64, 88), slack=1.0)]


def depth_panels(backend: Backend) -> tuple[Image, Image, Image]:
    """A triangle drawn twice, the second time from another vertex: where LESS lets the second one through."""
    size, (x0, y0, x1, y1) = (600, 600), (159, 120, 265, 200)
    xy, z = (values[22] for values in depths.twice())
    orders = ([0, 1, 2], [1, 2, 0])
    drawn = [depths.fragments(backend, clip_space(xy[o], size, z[o]), soup(1), size)[0, y0:y1, x0:x1] for o in orders]
    y, x = np.mgrid[y0:y1, x0:x1].astype(np.float32) + np.float32(0.5)
    window = z * np.float32(0.5) + np.float32(0.5)
    pairs = [depths.naive_depth("barycentric", xy[o], window[o], x, y) for o in orders]
    plain, exact = (pairs[1] < pairs[0]).astype(int), (drawn[1] < drawn[0]).astype(int)
    right = colored(exact)
    return colored(plain), right, marked(right, np.zeros(plain.shape, np.bool_), plain != exact)


def _picture(name: str, how: str, note: str, draw: Callable[[Backend], tuple[Image, Image, Image]], zoom: int) -> Picture:
    return Picture(name, (how, "bigtri", "pixels that differ"), note, draw, zoom)


_PINK = "Pink: missing. Yellow: drawn too often, or by the wrong triangle."
PICTURES: list[Picture] = [
    _picture(
        "ties",
        "float32, all barycentrics > 0",
        f"H02: 24 spokes through pixel centres. {_PINK}",
        coverage_panels(constructions.fan_through_centres, "strict", (86, 98, 172, 160)),
        5,
    ),
    _picture(
        "contraction",
        "float32 with top-left rule, compiled with FMA",
        f"H05: shared edges through pixel centres. {_PINK}",
        coverage_panels(one_pair, "fma", (1100, 395, 1186, 457)),
        5,
    ),
    _picture(
        "thin",
        "float32 with top-left rule, compiled with FMA",
        f"H10: 400 needles around a pixel centre. {_PINK}",
        coverage_panels(constructions.needles, "fma", (315, 363, 401, 425)),
        5,
    ),
    _picture(
        "far",
        "float32 with top-left rule",
        f"A fan from an apex 3.5 million pixels away. {_PINK}",
        coverage_panels(far_fan, "tl", (0, 0, 86, 62)),
        5,
    ),
    _picture(
        "overflow",
        "top-left rule, int32 products",
        f"H12: triangles as large as the screen. {_PINK}",
        coverage_panels(constructions.screen_filling, "i32", (0, 0, 430, 310)),
        1,
    ),
    _picture(
        "subpixel",
        "exact, vertices rounded to 1/16 px",
        f"H16: 3200 triangles smaller than a pixel. {_PINK}",
        coverage_panels(constructions.subpixel_mesh, "fixed4", (0, 0, 19, 18)),
        22,
    ),
    _picture(
        "clipping", "float32, divided by w without clipping", f"A floor that passes under the camera. {_PINK}", clip_panels, 3
    ),
    _picture(
        "depth",
        "float32, barycentric sum",
        "H34: a triangle drawn twice, the second time from another vertex. Light: the second one is nearer, by a rounding error.",
        depth_panels,
        4,
    ),
]
