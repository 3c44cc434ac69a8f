"""Plots of the accuracy study's rows: what each rung costs, what it gives up, and who is dominated. Needs matplotlib.

Raises:
    ImportError: there is no matplotlib; the text says what to install.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from ..precision import DEFAULT
from .accuracy import CONTROL, Row, front
from .pyplot import Axes, plt

# Colours apart for the colour-blind too (Okabe and Ito).
_COLORS = {
    "none": "#000000",
    "coverage": "#0072B2",
    "depth": "#D55E00",
    "mask": "#009E73",
    "clip": "#CC79A7",
    "attributes": "#E69F00",
    "samples": "#56B4E9",
}


class Kind(NamedTuple):
    """An error that a plot is drawn of."""

    name: str  # of the file
    fields: tuple[str, ...]  # of ``Row``, added up
    title: str
    axes: tuple[str, ...]  # the rungs that it is about, by what they change
    least: float  # what is less is drawn there

    def of(self, row: Row) -> float | None:
        """The row's error; None where it was not measured."""
        values = [getattr(row, field) for field in self.fields]
        return None if None in values else max(self.least, sum(values))


_COVERAGE = ("coverage", "clip")
KINDS = (
    Kind("wrong_pixels", ("wrong_ppm",), "wrong pixels, per million", _COVERAGE, 0.5),
    Kind("cracks", ("cracks_ppm", "overlaps_ppm"), "cracks and overlaps along shared edges, per million", _COVERAGE, 0.5),
    Kind("depth", ("depth_ulp_max",), "largest error of depth, ulp", ("depth",), 0.25),
    Kind("attributes", ("texels_max",), "largest error of a texture coordinate, texels of 1024", ("attributes",), 1e-5),
)


def draw_all(rows: Sequence[Row], folder: Path) -> list[Path]:
    """Writes a plot for each kind of error and one of the costs; returns the files. The folder is made if it is not there."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [path for kind in KINDS if (path := _fronts(rows, kind, folder)) is not None]
    return [_costs(rows, folder), *paths]


def _fronts(rows: Sequence[Row], kind: Kind, folder: Path) -> Path | None:
    """Error against time, a panel for each scene; the Pareto front is the line."""
    panels = []
    for here in _cases(rows):
        shown = [r for r in here if r.axis in (*kind.axes, "none") and kind.of(r) is not None]
        found = [kind.of(row) or kind.least for row in shown]
        if found and max(found) > 2 * min(found):  # a scene on which all do about the same says nothing
            panels.append((here, shown))
    if not panels:
        return None
    columns = min(3, len(panels))
    lines = -(-len(panels) // columns)
    figure, all_axes = plt.subplots(lines, columns, figsize=(4.6 * columns, 3.6 * lines), squeeze=False)
    for axes, (here, shown) in zip(all_axes.flat, panels, strict=False):
        _front(axes, here, shown, kind)
    for axes in all_axes.flat[len(panels) :]:
        axes.set_axis_off()
    if len(kind.axes) > 1:
        handles = [plt.Line2D([], [], marker="o", linestyle="", color=_COLORS[axis], label=axis) for axis in kind.axes]
        figure.legend(handles=handles, loc="lower right", ncols=len(handles), frameon=False, fontsize=8)
    figure.supylabel(kind.title + " (log)", size=10)
    figure.supxlabel("time over that of exact in the same round", size=10, y=0.03)
    return _saved(figure, folder / f"{kind.name}.png", rows[0])


def _front(axes: Axes, here: Sequence[Row], shown: Sequence[Row], kind: Kind) -> None:
    points = [(row.ratio, kind.of(row) or 0.0) for row in shown]
    control = next(row for row in here if row.precision == CONTROL)
    axes.axvspan(control.ratio_p25, control.ratio_p75, color="0.88", zorder=0)
    # What the clock cannot tell from exact costs as much as exact.
    costs = [1.0 if control.ratio_p25 <= ratio <= control.ratio_p75 else ratio for ratio, _ in points]
    best = set(front([(cost, float(f"{error:.1e}")) for cost, (_, error) in zip(costs, points, strict=True)]))
    names = _joined([(row.precision, point) for row, point in zip(shown, points, strict=True)])
    line = sorted(points[k] for k in best)
    axes.plot([x for x, _ in line], [y for _, y in line], color="0.5", linewidth=1, zorder=1, drawstyle="steps-post")
    for k, (row, (x, y)) in enumerate(zip(shown, points, strict=True)):
        spread = [[max(0.0, x - row.ratio_p25)], [max(0.0, row.ratio_p75 - x)]]
        filled = _COLORS[row.axis] if k in best else "white"
        axes.errorbar(
            x, y, xerr=spread, fmt="o", markersize=6, color=_COLORS[row.axis], markerfacecolor=filled, elinewidth=0.8, zorder=2
        )
    for text, (x, y) in names:
        box = {"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.7}
        axes.annotate(text, (x, y), (6, 4), textcoords="offset points", size=6.5, bbox=box, zorder=1.5)
    axes.set_yscale("log")
    axes.margins(x=0.3, y=0.22)
    axes.grid(alpha=0.3)
    axes.set_title(f"{here[0].scene}, {here[0].triangles} triangles, {here[0].width}x{here[0].height}", loc="left", size=9)


def _joined(named: Sequence[tuple[str, tuple[float, float]]]) -> list[tuple[str, tuple[float, float]]]:
    """Labels, those of points that nearly coincide in one, a line each."""
    result: list[tuple[list[str], tuple[float, float]]] = []
    all_x = [x for _, (x, _) in named]
    reach = 0.3 * (max(all_x) - min(all_x))
    for name, (x, y) in sorted(named, key=lambda one: one[1][0]):
        short = name.removeprefix("coverage_").removeprefix("depth_").removeprefix("attributes_")
        near = next((r for r in result if abs(r[1][0] - x) < reach and 1 / 1.5 < r[1][1] / y < 1.5), None)
        if near is None:
            result.append(([short], (x, y)))
        else:
            near[0].append(short)
    return [("\n".join(names), at) for names, at in result]


def _costs(rows: Sequence[Row], folder: Path) -> Path:
    """What each rung takes, of the time of exact: a dot for each scene, its quartiles as a whisker."""
    cases = _cases(rows)
    names = [row.precision for row in rows if row.axis not in ("none", "samples")]
    names = list(dict.fromkeys(names))
    figure, axes = plt.subplots(figsize=(9, 0.27 * len(names) + 1.6))
    markers = "osD^v<>PX*hp8d"
    for number, here in enumerate(cases):
        off = (number - (len(cases) - 1) / 2) * 0.7 / len(cases)
        mine = [row for row in here if row.precision in names]
        at = [names.index(row.precision) + off for row in mine]
        spread = [
            [max(0.0, row.ratio - row.ratio_p25) for row in mine],
            [max(0.0, row.ratio_p75 - row.ratio) for row in mine],
        ]
        label = here[0].scene if len({(h[0].width, h[0].height) for h in cases}) == 1 else _title(here)
        axes.errorbar(
            [row.ratio for row in mine],
            at,
            xerr=spread,
            fmt=markers[number % len(markers)],
            markersize=3.5,
            elinewidth=0.7,
            label=label,
        )
    axes.axvline(1, color="0.4", linewidth=0.8)
    axes.set_xscale("log", base=2)
    low, high = axes.get_xlim()
    ticks = [t for t in (0.5, 0.7, 0.8, 0.9, 1, 1.1, 1.2, 1.4, 1.7, 2, 2.5, 3, 4, 5, 6, 8, 12, 16) if low <= t <= high]
    axes.set_xticks(ticks, [f"{t:g}" for t in ticks], size=7)
    axes.minorticks_off()
    axes.set_yticks(range(len(names)), names, size=8)
    axes.invert_yaxis()
    axes.grid(alpha=0.3)
    axes.set_xlabel(f"time over that of {DEFAULT} in the same round (log)", size=9)
    axes.legend(frameon=False, fontsize=7, loc="upper left", bbox_to_anchor=(1, 1))
    return _saved(figure, folder / "costs.png", rows[0])


def _title(here: Sequence[Row]) -> str:
    return f"{here[0].scene} {here[0].width}x{here[0].height}"


def _cases(rows: Sequence[Row]) -> list[list[Row]]:
    """The rows of each case together."""
    found: dict[tuple[str, int, int], list[Row]] = {}
    for row in rows:
        found.setdefault((row.scene, row.width, row.height), []).append(row)
    return list(found.values())


def _saved(figure: plt.Figure, path: Path, row: Row) -> Path:
    where = f"{row.threads} threads, {row.isa}" if row.isa else row.device
    text = (
        f"{row.device}; {row.versions.split(';')[0]} ({row.commit}), {row.variant}, {where}; filled, on the line: the Pareto "
        "front; grey band: quartiles of exact against exact"
    )
    figure.tight_layout(rect=(0, 0.035, 1, 1))
    figure.text(0.01, 0.005, text, size=6, color="0.4")
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return path
