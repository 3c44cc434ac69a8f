"""Pictures of the CSVs that cuda_run.py and cuda_scaling.py write.

* `cuda_scenes_WxH.png`: each scene's time as a multiple of a memset of the image, with the floor and other rasterizers;
* `cuda_scaling.png`: time against area, number of triangles, layers and resolution, with the points at which another path of
bin_owned becomes the fastest;
* `cuda_sweeps.png`: "auto" on the bumpy body against number of triangles, share of the screen, resolution and views;
* `cuda_rows.png`: time against the longest side of a triangle that is drawn by rows.

    python bench/cuda_plot.py --run bench/results/cuda_h200.csv --out docs/img
"""

from __future__ import annotations

import argparse
import math
import textwrap
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import cuda_cases
import cuda_floor
import cuda_run
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator
from plot import Row, distinct, save, where

from bigtri.study import scenes
from bigtri.study.benchmark import read_csv

# colours apart for the colour-blind too (Okabe and Ito)
COLORS = {
    "auto": "#0072B2",
    "bin_owned": "#0072B2",
    "two_stage": "#CC79A7",
    "persistent": "#009E73",
    "bin_owned few": "#56B4E9",
    "bin_owned rows": "#D55E00",
    "bin_owned share 32": "#E69F00",
    "bin_owned share 128": "#F0E442",
    "bin_owned share 256": "#882255",
    "bin_owned share 1024": "#000000",
    "floor": "#999999",
    "CuRast": "#E69F00",
    "nvdiffrast": "#D55E00",
}
OTHERS = ("#332288", "#882255", "#999933", "#7F7F7F")  # of variants that have none
PEERS = ("CuRast", "nvdiffrast")
PATHS = tuple(way.name for way in cuda_cases.PATHS)
FASTER = 1.03  # by how much another way has to be faster to count as a change


def color_of(name: str, names: Sequence[str]) -> str:
    """A name's colour; names: all that are in the picture."""
    new = [other for other in names if other not in COLORS]
    return COLORS[name] if name in COLORS else OTHERS[new.index(name) % len(OTHERS)]


def line_of(name: str, names: Sequence[str]) -> dict[str, Any]:
    """How a name's curve is drawn: a broad line below the others for bin_owned, which takes one of its paths."""
    broad = name == "bin_owned"
    return {"color": color_of(name, names), "lw": 4 if broad else 1.2, "alpha": 0.35 if broad else 0.95}


def short(us: float) -> str:
    return f"{us / 1e3:.3g}k" if us >= 9950 else f"{us:.0f}" if us >= 99.5 else f"{us:.3g}"


def plain_log(axes: Axes) -> None:
    """Numbers as they are along y, also between the powers of ten where there are few of these."""
    plain = FuncFormatter(lambda value, _: f"{value:,g}")
    axes.yaxis.set_major_formatter(plain)
    low, high = axes.get_ylim()
    if high / low < 100:
        axes.yaxis.set_minor_locator(LogLocator(subs=(2, 5)))
        axes.yaxis.set_minor_formatter(plain)
    else:
        axes.yaxis.set_minor_formatter(NullFormatter())


# --- scenes


def bars_of(rows: list[Row], width: str, height: str) -> dict[str, dict[str, tuple[float, float, float]]]:
    """By name and scene (median, p25, p75) in us: the floor, bigtri's variants, other rasterizers; rows: of one size and seed."""
    found: dict[str, dict[str, tuple[float, float, float]]] = {}
    for row in where(rows, method="graph"):
        timing = (float(row["us_median"]), float(row["us_p25"]), float(row["us_p75"]))
        name = "floor" if row["variant"] in cuda_floor.KINDS else row["variant"]
        mine = found.setdefault(name, {})
        mine[row["scene"]] = min(timing, mine.get(row["scene"], timing))  # the faster of the two floors
    for (peer, scene, w, h), us in cuda_run.read_peers().items():
        if peer in PEERS and (str(w), str(h)) == (width, height) and any(scene == row["scene"] for row in rows):
            found.setdefault(peer, {})[scene] = (us, us, us)
    return found


def scene_bars(rows: list[Row], out: Path) -> None:
    """A picture for each size."""
    rows = [row for row in where(rows, seed=str(scenes.SEED)) if row.get("views", "1") == "1"]  # older CSVs have no batches
    for width, height in distinct(rows, "width", "height"):
        here = where(rows, width=width, height=height)
        us = bars_of(here, width, height)
        memset = us.pop("memset", None)
        us.pop("empty kernel", None)
        if len(us) > 1:
            us.pop("auto", None)  # the first variant under another name
        if memset is None:
            print(f"{width}x{height}: no memset to compare with")
            continue
        order = [name for name in ("floor", *us) if name in us]
        names = list(dict.fromkeys(name for name in order if name not in PEERS)) + [name for name in PEERS if name in us]
        scene_names = [name for (name,) in distinct(here, "scene")]
        breadth = 0.86 / len(names)
        figure, axes = plt.subplots(figsize=(max(12, 1.3 * len(scene_names)), 4.6))
        for number, name in enumerate(names):
            shown = [(at, scene) for at, scene in enumerate(scene_names) if scene in us[name] and scene in memset]
            at = [x + (number - (len(names) - 1) / 2) * breadth for x, _ in shown]
            median, low, high = ([us[name][scene][k] / memset[scene][0] for _, scene in shown] for k in range(3))
            whiskers = [[m - p for m, p in zip(median, low, strict=True)], [p - m for m, p in zip(median, high, strict=True)]]
            axes.bar(at, median, breadth, yerr=whiskers, label=name, color=color_of(name, names), error_kw={"lw": 0.8})
            for x, (_, scene), top in zip(at, shown, high, strict=True):
                text = short(us[name][scene][0])
                axes.annotate(text, (x, top), (0, 2), textcoords="offset points", ha="center", size=6, rotation=90)
        axes.axhline(1, color="0.3", lw=0.8)
        mean = math.exp(sum(math.log(value[0]) for value in memset.values()) / len(memset))
        axes.set_yscale("log")
        axes.margins(x=0.01)
        axes.set_ylim(0.7, axes.get_ylim()[1] * 2)
        plain_log(axes)
        axes.set_ylabel("time / memset of the image (log)")
        axes.set_title(f"{width} x {height}; over the bars: us a frame; memset: {short(mean)} us", loc="left", size=10)
        known = {name: recipe.title for name, recipe in scenes.SCENES.items()}
        titles = [f"{name}\n{textwrap.fill(known.get(name, ''), 26)}" for name in scene_names]
        axes.set_xticks(range(len(scene_names)), titles, size=7)
        axes.grid(axis="y", alpha=0.3)
        axes.set_axisbelow(True)
        axes.legend(frameon=False, ncols=len(names), loc="lower right", bbox_to_anchor=(1, 1), fontsize=8, borderaxespad=0.2)
        caption(figure, here, "CUDA graph replay, median, whiskers: quartiles; others measured on an H200 (h200_peers.csv)")
        save(figure, out / f"cuda_scenes_{width}x{height}.png")


# --- scaling


def crossovers(x: Sequence[float], us: dict[str, Sequence[float | None]]) -> list[tuple[float, str, str]]:
    """Where another way becomes the fastest: (x, from, to), between two points by straight lines in log-log.

    us: each way's times at the x, which rise; None where there is none. A change counts where it is more than 3 %.
    """
    changes = []
    best: str | None = None
    last: int | None = None  # the point before
    for i in range(len(x)):
        there = {name: now for name, times in us.items() if (now := times[i]) is not None}
        if not there:
            continue
        fastest = min(there, key=there.__getitem__)
        if best is None:
            best = fastest
        elif fastest != best and (best not in there or there[best] > FASTER * there[fastest]):
            before = x[last] if last is not None else x[i]
            at = math.sqrt(before * x[i])
            was, other = (None, None) if last is None else (us[best][last], us[fastest][last])
            if best in there and was is not None and other is not None:
                a, b = math.log(was / other), math.log(there[best] / there[fastest])
                if a < 0 < b:
                    at = before * (x[i] / before) ** (-a / (b - a))
            changes.append((at, best, fastest))
            best = fastest
        last = i
    return changes


PANELS = {  # curve: title, label of x
    "area": ("Area of a triangle, fragments fixed", "area of a triangle, px"),
    "count": ("Number of triangles, 1920 x 1080", "triangles"),
    "depth": ("Full-screen layers, 1920 x 1080", "layers"),
    "resolution": ("Resolution", "side of the square image, px"),
}
SWEEPS = {
    "body_count": ("Number of triangles", "triangles"),
    "body_share": ("16,000 triangles, near and far", "height of the ball around the body, % of the picture"),
    "body_resolution": ("Resolution", "side of the square image, px"),
    "body_views": ("Views of a batch", "views"),
}
STYLES = ("-", "--", ":", "-.")


def styled(here: list[Row]) -> list[tuple[str, str]]:
    """A line style for each kind of a panel.

    Raises:
        ValueError: there are more kinds than styles.
    """
    kinds = [kind for (kind,) in distinct(here, "kind")]
    if len(kinds) > len(STYLES):
        raise ValueError(f"a panel has {len(STYLES)} line styles, not one for each of {', '.join(kinds)}")
    return list(zip(STYLES, kinds, strict=False))


def name_of(row: Row) -> str:
    return f"{row['variant']} {row['path']}".strip()


def curve(rows: Iterable[Row]) -> list[tuple[float, float, float, float]]:
    """(x, median, p25, p75) with rising x."""
    return sorted((float(row["x"]), float(row["us_median"]), float(row["us_p25"]), float(row["us_p75"])) for row in rows)


def scaling_panel(axes: Axes, here: list[Row], names: list[str]) -> None:
    for style, kind in styled(here):
        for name in names:
            points = curve(row for row in where(here, kind=kind) if name_of(row) == name)
            if not points:
                continue
            x, us, low, high = zip(*points, strict=True)
            line = line_of(name, names)
            axes.plot(x, us, style, marker=None if name == "bin_owned" else "o", ms=2.5, **line)
            axes.fill_between(x, low, high, color=line["color"], alpha=0.15, lw=0)
        memset = sorted({(float(row["x"]), float(row["us_memset"])) for row in where(here, kind=kind) if row["us_memset"]})
        if memset:
            axes.plot(*zip(*memset, strict=True), style, color="0.5", lw=0.8)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.grid(alpha=0.3)
    handles = [Line2D([], [], color="0.3", ls=style, lw=1.2, label=kind) for style, kind in styled(here)]
    axes.legend(handles=handles, frameon=False, fontsize=7.5, loc="best")


def mark_crossovers(axes: Axes, here: list[Row]) -> None:
    """A line and a label where another of bin_owned's paths becomes the fastest, for each kind."""
    height = 0.02
    marked: list[tuple[float, str, str]] = []
    for style, kind in styled(here):
        mine = where(here, kind=kind)
        x = sorted({float(row["x"]) for row in mine})
        at = {(name_of(row), float(row["x"])): float(row["us_median"]) for row in mine}
        changes = crossovers(x, {name: [at.get((name, value)) for value in x] for name in PATHS})
        for value, before, after in changes:
            if any((b, a) == (before, after) and abs(math.log(value / other)) < 0.15 for other, b, a in marked):
                continue  # the same as for another kind
            marked.append((value, before, after))
            axes.axvline(value, color="0.35", ls=style, lw=0.8)
            text = f"{path_of(before)} | {path_of(after)} at {rounded(value)}"
            axes.annotate(
                text,
                (value, height),
                (3, 0),
                xycoords=("data", "axes fraction"),
                textcoords="offset points",
                size=7,
                color="0.2",
                bbox={"fc": "white", "ec": "none", "alpha": 0.8, "pad": 1},
            )
            height += 0.05


def path_of(name: str) -> str:
    return name.removeprefix("bin_owned ")


def rounded(value: float) -> str:
    """To two figures, without an exponent."""
    return f"{round(value, 1 - math.floor(math.log10(value))):,g}" if value < 1e5 else f"{value:,.0f}"


def scaling(rows: list[Row], out: Path) -> None:
    how = "CUDA graph replay, median, bands: quartiles; upright lines: where another path of bin_owned becomes the fastest"
    four_panels(rows, PANELS, how, out / "cuda_scaling.png")


def sweeps(rows: list[Row], out: Path) -> None:
    four_panels(rows, SWEEPS, "CUDA graph replay, median, bands: quartiles", out / "cuda_sweeps.png")


def four_panels(rows: list[Row], panels_of: dict[str, tuple[str, str]], how: str, file: Path) -> None:
    """A picture of up to four curves."""
    shown = [name for name in panels_of if where(rows, curve=name)]
    rows = [row for row in rows if row["curve"] in shown]
    names = list(dict.fromkeys(name_of(row) for row in rows))
    figure, panels = plt.subplots(2, 2, figsize=(12, 9), squeeze=False)
    for axes in panels.flat[len(shown) :]:
        axes.set_visible(False)
    for axes, name in zip(panels.flat, shown, strict=False):
        here = where(rows, curve=name)
        scaling_panel(axes, here, names)
        mark_crossovers(axes, here)
        plain_log(axes)
        title, label = panels_of[name]
        axes.set_title(title, loc="left", size=10)
        axes.set_xlabel(label)
        axes.set_ylabel("us a frame (log)")
        if name.endswith("resolution"):
            sides = sorted(side for side in {int(row["x"]) for row in here} if side.bit_count() == 1)
            axes.set_xticks(sides, [str(side) for side in sides], size=8)
            axes.xaxis.set_minor_locator(NullLocator())
    handles = [Line2D([], [], label=name, **line_of(name, names)) for name in names]
    handles.append(Line2D([], [], color="0.5", lw=0.8, label="memset"))
    figure.legend(
        handles=handles,
        frameon=False,
        ncols=len(handles),
        loc="upper center",
        bbox_to_anchor=(0.5, 1.0),
        fontsize=8,
        columnspacing=1.2,
        handlelength=1.5,
    )
    caption(figure, rows, how)
    save(figure, file, top=0.97)


def widest(rows: list[Row], out: Path) -> None:
    """The curve `rows`, a panel for each variant: time over its best, a line for each size of triangle."""
    here = where(rows, curve="rows")
    if not here:
        return
    ways = list(dict.fromkeys(name_of(row) for row in here))
    kinds = sorted({row["kind"] for row in here}, key=lambda kind: int(kind.split()[0]))
    values = sorted({int(row["x"]) for row in here})
    colors = plt.get_cmap("viridis")
    figure, panels = plt.subplots(1, len(ways), figsize=(4.3 * len(ways), 4.2), squeeze=False, sharey=True)
    for axes, way in zip(panels[0], ways, strict=True):
        for number, kind in enumerate(kinds):
            points = curve(row for row in where(here, kind=kind) if name_of(row) == way)
            if not points:
                continue
            best = min(us for _, us, *_ in points)
            at = [values.index(int(x)) for x, *_ in points]
            color = colors(number / max(1, len(kinds)))
            axes.plot(at, [us / best for _, us, *_ in points], "o-", color=color, ms=3, label=f"{kind}, best {short(best)} us")
        axes.set_xticks(range(len(values)), [str(value) for value in values], size=7)
        axes.set_yscale("log")
        plain_log(axes)
        axes.set_title(way, loc="left", size=10)
        axes.set_xlabel("longest side that is drawn by rows, px")
        axes.grid(alpha=0.3)
        axes.legend(frameon=False, fontsize=7, title="triangles of", title_fontsize=7)
    panels[0, 0].set_ylabel("time / best of the line (log)")
    caption(figure, here, "CUDA graph replay, median; four layers over 1920 x 1080; what is wider waits")
    save(figure, out / "cuda_rows.png")


def caption(figure: plt.Figure, rows: list[Row], how: str) -> None:
    """Where the figures come from, along the bottom."""
    row, commits = rows[0], " and ".join(sorted({row["commit"] for row in rows}))
    text = f"{row['device']}, driver {row['driver']}, CUDA {row['cuda']}; bigtri {commits}; {how}"
    figure.text(0.01, 0.005, text, size=6.5, color="0.4")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument(
        "--run", type=Path, nargs="+", metavar="CSV", help="what cuda_run.py wrote; of several rows for a bar the fastest"
    )
    parser.add_argument("--scaling", type=Path, metavar="CSV", help="what cuda_scaling.py wrote")
    parser.add_argument("--sweeps", type=Path, metavar="CSV", help="what cuda_scaling.py --curves sweeps wrote")
    parser.add_argument("--out", type=Path, default=Path("docs/img"), help="folder of the pictures (default docs/img)")
    arguments = parser.parse_args()
    if not (arguments.run or arguments.scaling or arguments.sweeps):
        parser.error("--run, --scaling or --sweeps")
    if arguments.run:
        scene_bars([row for file in arguments.run for row in read_csv(file)], arguments.out)
    if arguments.scaling:
        rows = read_csv(arguments.scaling)
        scaling(rows, arguments.out)
        widest(rows, arguments.out)
    if arguments.sweeps:
        sweeps(read_csv(arguments.sweeps), arguments.out)


if __name__ == "__main__":
    main()
