"""Pictures of a scene's work, variant by variant, from the build that counts: heat maps, overdraw, load. Needs matplotlib.

Raises:
    ImportError: there is no matplotlib; the text says what to install.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import native
from ..check.counters import load
from ..check.work_map import WorkMap, map_work
from ..ops.rasterize import rasterize
from ..reference.numerics import TILE
from ..reference.variants import MODELS
from ..rendering.views import triangle_ids
from .compare import Job
from .pyplot import Axes, FuncFormatter, LogLocator, LogNorm, Normalize, plt

_DECADES = 5  # of a logarithmic scale, below its highest value; what is less has its lowest colour
_COLORS = "inferno"
_NOTHING = "0.82"  # the grey of what has no work
_LEAST = 1e-2  # of a task's work over the mean, that is shown
_PREFIXES = ((1e9, "G"), (1e6, "M"), (1e3, "k"))


def draw_all(job: Job, scene: str, variants: Sequence[str], folder: Path) -> list[Path]:
    """Write work.png, overdraw.png and load.png; returns the files. The folder is made if it is not there.

    Args:
        job: what is drawn, with a rung whose work is counted on its device.
        scene: what it is called.
        variants: those of the device whose work is counted.
    """
    maps = {variant: _map(job, variant) for variant in variants}
    folder.mkdir(parents=True, exist_ok=True)
    height, width = job.resolution
    about = f"{scene}, {len(job.triangles)} triangles, {width}x{height} px, {job.precision}"
    return [
        _work(job, maps, about, folder / "work.png"),
        _overdraw(job, maps, about, folder / "overdraw.png"),
        _load(job, maps, about, folder / "load.png"),
    ]


def _map(job: Job, variant: str, **parameters: int) -> WorkMap:
    mesh = job.positions, job.triangles, job.resolution
    return map_work(
        *mesh,
        variant=variant,
        backend="native",
        device=job.device,
        precision=job.precision,
        cull=job.cull,
        parameters=parameters,
    )


def _early_reject(job: Job, variant: str) -> str:
    """The parameter for it; empty: there is none."""
    if job.device == "cpu":
        return MODELS[variant].REJECTS_BY_DEPTH
    return "early_z" if "early_z" in native.REGISTRY[job.device][job.precision][variant].parameters else ""


def _work(job: Job, maps: Mapping[str, WorkMap], about: str, path: Path) -> Path:
    """Edge values, if they are counted, and fragments in each tile of 8x8 px, over its pixels; one colour scale for all."""
    height, width = job.resolution
    down, across = -(-height // TILE), -(-width // TILE)
    titles, by_tile = ["what is drawn\na colour per triangle"], []
    for variant, work in maps.items():
        by_tile.append(work.by_tile()[:down, :across] / TILE**2)
        edges = work.counters.get("edges_64", 0) + work.counters.get("edges_32", 0)
        tests = f"{_short(edges)} edge values, " if work.edges is not None else ""
        titles.append(f"{variant}\n{tests}{_short(work.counters.get('fragments', 0))} fragments")
    scale = _scale(by_tile)
    figure, panels = _panels(titles, height / width)
    drawn = rasterize(job.positions, job.triangles, job.resolution, precision=job.precision, cull=job.cull)
    panels[0].imshow(triangle_ids(drawn), extent=(0, width, height, 0))
    for axes, values in zip(panels[1:], by_tile, strict=True):
        _image(axes, values, TILE, job.resolution, scale)
    tested = any(work.edges is not None for work in maps.values())
    _color_bar(figure, panels, scale, "edge values and\nfragments per pixel" if tested else "fragments per pixel")
    return _saved(figure, path, f"{about}: where each variant does its work, tiles of 8x8 px. Grey: none")


def _overdraw(job: Job, maps: Mapping[str, WorkMap], about: str, path: Path) -> Path:
    """Fragments offered to each pixel, with and without early reject. Settings that offer the same ones share a panel."""
    height, width = job.resolution
    settings: list[tuple[str, WorkMap, bool]] = []  # whether anything was rejected; on CUDA whether it may have been
    for variant, work in maps.items():
        early = _early_reject(job, variant)
        for value in (0, 1) if early else (None,):
            one = _map(job, variant, **{early: value}) if value is not None else work
            hidden = not one.counters.keys().isdisjoint(("bins_hidden", "tiles_hidden"))
            name = f"{variant} {early}={value}" if early else variant
            settings.append((name, one, hidden if job.device == "cpu" else value == 1))
    # By whether anything was rejected, and the picture.
    groups: list[tuple[bool, NDArray[np.int64], list[str]]] = []
    for name, work, rejects in settings:
        image = work.fragments[:height, :width]
        same = (names for other, seen, names in groups if other == rejects and np.array_equal(seen, image))
        names = next(same, None)
        if names is None:
            groups.append((rejects, image, names := []))
        names.append(name)
    groups.sort(key=lambda group: (group[0], -int(group[1].sum())))
    scale = _scale([image for _, image, _ in groups])
    titles = []
    for rejects, image, names in groups:
        mean = image.sum() / max(1, np.count_nonzero(image))
        what = "early reject by depth" if rejects else "nothing rejected by depth"
        titles.append("\n".join([*_lines(names), f"{what}: mean {mean:.3g}, most {image.max()}"]))
    figure, panels = _panels(titles, height / width, most=3)
    for axes, (_, image, _) in zip(panels, groups, strict=True):
        _image(axes, image, 1, job.resolution, scale)
    _color_bar(figure, panels, scale, "fragments per pixel")
    return _saved(figure, path, f"{about}: overdraw. Mean of the pixels that are covered; grey: none")


def _load(job: Job, maps: Mapping[str, WorkMap], about: str, path: Path) -> Path:
    """The work of each task over the mean, the most first."""
    titles, task = [], "task" if job.device == "cpu" else "block"
    for variant, work in maps.items():
        count = len(work.tasks)
        titles.append(f"{variant}\n{_short(count)} {task}{'s' * (count != 1)}, load {load(work.counters):.3g}")
    figure, panels = _panels(titles, 0.75, most=5, share=True)
    most, longest = 1.0, 1
    for axes, work in zip(panels, maps.values(), strict=True):
        if count := len(work.tasks):
            values = work.tasks / work.tasks.mean()
            axes.stairs(values, np.arange(1, count + 2), baseline=_LEAST / 10, fill=True, color="#0072B2")
            most, longest = max(most, values[0]), max(longest, count)
        axes.axhline(1, color="#D55E00", linewidth=0.9)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.tick_params(labelsize=7, labelbottom=True)
        axes.grid(axis="y", alpha=0.3)
        axes.set_axisbelow(True)
    panels[0].set_ylim(_LEAST, 2 * most)
    panels[0].set_xlim(1, longest + 1)
    figure.supxlabel(f"{task}s, the one with the most work first (log)", size=8)
    figure.supylabel("work over the mean (log)", size=8)
    return _saved(figure, path, f"{about}: work of each {task}. Load: the most over the mean, which is the line")


def _panels(titles: Sequence[str], aspect: float, most: int = 4, share: bool = False) -> tuple[Any, list[Axes]]:
    """Panels of height over width ``aspect``, one below each title; ``most`` side by side, or one less to leave fewer empty."""
    columns = min((most, most - 1), key=lambda columns: -len(titles) % columns) if len(titles) > most else len(titles)
    rows = -(-len(titles) // columns)
    lines = sum(max(title.count("\n") + 1 for title in titles[row * columns :][:columns]) for row in range(rows))
    wide = 7.0 if columns == 1 else min(3.6, 10 / columns)  # inches
    size = (wide * columns + 1, rows * (wide * aspect + 0.1) + 0.14 * lines + 0.5)
    figure, panels = plt.subplots(rows, columns, figsize=size, squeeze=False, sharex=share, sharey=share, layout="constrained")
    for axes, title in zip(panels.flat, titles, strict=False):
        axes.set_title(title, size=7.5)
    for axes in panels.flat[len(titles) :]:
        axes.set_axis_off()
    return figure, list(panels.flat[: len(titles)])


def _scale(images: Sequence[NDArray[Any]]) -> Normalize:
    """Colours for what is above 0: logarithmic, unless all of it is within a factor of 12."""
    positive = np.concatenate([image[image > 0] for image in images])
    low, high = (positive.min(), positive.max()) if len(positive) else (1.0, 2.0)
    if high <= 12 * low:
        return Normalize(0, high)
    return LogNorm(max(low, high / 10**_DECADES), high)


def _image(axes: Axes, values: NDArray[Any], size: int, resolution: tuple[int, int], scale: Normalize) -> None:
    """Values of squares of ``size`` px; the last ones may reach beyond the image."""
    height, width = resolution
    down, across = values.shape
    axes.imshow(
        np.ma.masked_equal(values.astype(np.float64), 0),
        norm=scale,
        cmap=plt.get_cmap(_COLORS).with_extremes(bad=_NOTHING),
        extent=(0, across * size, down * size, 0),
        interpolation="nearest" if size > 1 else "auto",
    )
    axes.set_xlim(0, width)
    axes.set_ylim(height, 0)


def _color_bar(figure: Any, panels: Sequence[Axes], scale: Normalize, title: str) -> None:
    for axes in panels:
        axes.set_xticks([])
        axes.set_yticks([])
    mappable = plt.cm.ScalarMappable(scale, _COLORS)
    bar = figure.colorbar(mappable, ax=figure.axes, location="right", shrink=0.8, aspect=40, pad=0.01)
    if isinstance(scale, LogNorm):
        few = bar.vmax <= 1000 * bar.vmin
        bar.ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if few else (1,)))
        bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    bar.set_label(title, size=8)
    bar.ax.tick_params(labelsize=7)


def _lines(names: Sequence[str]) -> list[str]:
    """Names, separated by commas, of some 60 characters a line."""
    return textwrap.wrap(", ".join(name.replace(" ", "\xa0") for name in names), 60)


def _short(n: int) -> str:
    for value, prefix in _PREFIXES:
        if n >= value:
            return f"{n / value:.3g} {prefix}"
    return str(n)


def _saved(figure: Any, path: Path, caption: str) -> Path:
    figure.suptitle(caption, size=9, x=0.005, ha="left")
    figure.savefig(path, dpi=100)
    plt.close(figure)
    return path
