"""Pictures of the CSVs that run.py and scaling.py write.

python bench/plot.py --run bench/results/cpu.csv --scaling bench/results/scaling.csv --out docs/img
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.container import BarContainer

from bigtri.study.benchmark import read_csv

Row = dict[str, str]

# colours apart for the colour-blind too (Okabe and Ito)
COLORS = {"bigtri": "#0072B2", "llvmpipe": "#E69F00", "numpy": "#009E73", "skimage": "#CC79A7", "opencv": "#56B4E9"}


def distinct(rows: Iterable[Row], *fields: str) -> list[tuple[str, ...]]:
    """The combinations of the fields' values, in the order in which they first appear."""
    return list(dict.fromkeys(tuple(row[field] for field in fields) for row in rows))


def where(rows: Iterable[Row], **values: str) -> list[Row]:
    return [row for row in rows if all(row[field] == value for field, value in values.items())]


def label_bars(axes: Axes, bars: BarContainer, rows: list[Row]) -> None:
    """Milliseconds over each bar and, for peers, how many times bigtri's."""
    for bar, row in zip(bars, rows, strict=True):
        ms = float(row["ms_median"])
        text = f"{ms:.0f}" if ms >= 100 else f"{ms:.3g}"
        if row["ratio"]:
            text += f"\n{float(row['ratio']):.{0 if float(row['ratio']) >= 10 else 1}f}x"
        axes.annotate(
            text,
            (bar.get_x() + bar.get_width() / 2, float(row["ms_p75"])),
            (0, 2),
            textcoords="offset points",
            ha="center",
            size=7,
        )


def bars(rows: list[Row], out: Path) -> None:
    """A picture for each resolution: time by scene, a panel for each thread count, quartiles as whiskers."""
    for width, height in distinct(rows, "width", "height"):
        here = where(rows, width=width, height=height)
        counts = distinct(here, "threads")
        figure, panels = plt.subplots(len(counts), 1, figsize=(10, 3.4 * len(counts)), sharex=True, squeeze=False)
        names = [name for (name,) in distinct(here, "scene")]
        renderers = [name for (name,) in distinct(here, "renderer")]
        breadth = 0.8 / len(renderers)
        for axes, (threads,) in zip(panels[:, 0], counts, strict=True):
            for number, renderer in enumerate(renderers):
                mine = where(here, threads=threads, renderer=renderer)
                at = [names.index(row["scene"]) + (number - (len(renderers) - 1) / 2) * breadth for row in mine]
                ms, low, high = ([float(row[field]) for row in mine] for field in ("ms_median", "ms_p25", "ms_p75"))
                whiskers = [[m - p for m, p in zip(ms, low, strict=True)], [p - m for m, p in zip(ms, high, strict=True)]]
                made = axes.bar(at, ms, breadth, yerr=whiskers, label=renderer, color=COLORS.get(renderer), capsize=2)
                label_bars(axes, made, mine)
            axes.set_yscale("log")
            axes.margins(y=0.15)
            axes.set_ylabel("ms a frame (log)")
            axes.set_title(f"{width} x {height}, {threads} thread{'s' if threads != '1' else ''}", loc="left", size=10)
            axes.grid(axis="y", alpha=0.3)
            axes.set_axisbelow(True)
        panels[-1, 0].set_xticks(range(len(names)), names)
        panels[0, 0].legend(frameon=False, ncols=len(renderers), loc="lower right", bbox_to_anchor=(1, 1))
        caption(figure, here[0])
        save(figure, out / f"scenes_{width}x{height}.png")


SWEEPS = {
    "resolution": ("side of the square image, px", "Resolution"),
    "count": ("triangles", "Number of triangles, 1920 x 1080"),
    "area": ("area of a triangle, px", "Area of a triangle, four layers, 1920 x 1080"),
}
KINDS = {
    ("resolution", "S3"): "32 very large triangles",
    ("resolution", "one"): "1 full-screen triangle",
    ("count", "large"): "500 to 5000 px",
    ("count", "mesh"): "mesh, 10 px",
    ("area", "mesh"): "mesh",
}


def sweeps(rows: list[Row], out: Path) -> None:
    """One picture with a panel for each curve of scaling.py, at each thread count."""
    shown = [name for name in SWEEPS if any(row["scene"].startswith(f"{name} ") for row in rows)]
    figure, panels = plt.subplots(1, len(shown), figsize=(5.2 * len(shown), 5.2), squeeze=False)
    threads_shown = [threads for (threads,) in distinct(rows, "threads")]
    for axes, sweep in zip(panels[0], shown, strict=True):
        here = [row for row in rows if row["scene"].startswith(f"{sweep} ")]
        markers: dict[str, str] = {}
        for row in here:
            row["kind"], row["x"] = row["scene"].split()[1:]
            markers.setdefault(row["kind"], "os^"[len(markers)])
        for renderer, variant_group, kind, threads in curve_keys(here):
            points = [row for row in where(here, renderer=renderer, kind=kind, threads=threads) if group(row) == variant_group]
            x, ms, low, high = ([float(row[field]) for row in points] for field in ("x", "ms_median", "ms_p25", "ms_p75"))
            style = "-" if threads == threads_shown[-1] else "--"
            text = f"{variant_group}, {KINDS[sweep, kind]}, {threads} thr."
            color = COLORS.get(renderer)
            axes.plot(x, ms, style, marker=markers[kind], markersize=4, color=color, label=text, alpha=0.9)
            axes.fill_between(x, low, high, color=color, alpha=0.15)
        axes.set_xscale("log", base=2 if sweep == "resolution" else 10)
        axes.set_yscale("log")
        axes.set_xlabel(SWEEPS[sweep][0])
        axes.set_title(SWEEPS[sweep][1], loc="left", size=10)
        axes.grid(alpha=0.3)
        if sweep == "resolution":
            sides = sorted({int(row["x"]) for row in here})
            axes.set_xticks(sides, [str(side) for side in sides], size=8)
            axes.minorticks_off()
        axes.legend(
            frameon=False, fontsize=7, ncols=2, handlelength=4, markerscale=0.6, loc="upper center", bbox_to_anchor=(0.5, -0.14)
        )
    panels[0, 0].set_ylabel("ms a frame (log)")
    caption(figure, rows[0])
    save(figure, out / "scaling.png")


def group(row: Row) -> str:
    """What a curve is called: bigtri's variants are curves of their own, a peer's ways are not."""
    return row["renderer"] if row["renderer"] != "bigtri" or row["variant"] == "auto" else f"bigtri {row['variant']}"


def curve_keys(rows: list[Row]) -> list[tuple[str, str, str, str]]:
    return list(dict.fromkeys((row["renderer"], group(row), row["kind"], row["threads"]) for row in rows))


def caption(figure: plt.Figure, row: Row) -> None:
    """Where the figures come from, along the bottom."""
    text = (
        f"{row['device']}; {row['versions'].split(';')[0]} ({row['commit']}), {row['isa']}; median, whiskers and bands: quartiles"
    )
    figure.text(0.01, 0.005, text, size=6.5, color="0.4")


def save(figure: plt.Figure, path: Path, top: float = 1) -> None:
    """top: how far up the panels may reach, of the figure's height."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.tight_layout(rect=(0, 0.02, 1, top))
    figure.savefig(path, dpi=150)
    plt.close(figure)
    print(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--run", type=Path, metavar="CSV", help="what run.py wrote")
    parser.add_argument("--scaling", type=Path, metavar="CSV", help="what scaling.py wrote")
    parser.add_argument("--out", type=Path, default=Path("docs/img"), help="folder of the pictures (default docs/img)")
    arguments = parser.parse_args()
    if not (arguments.run or arguments.scaling):
        parser.error("--run, --scaling or both")
    if arguments.run:
        bars(read_csv(arguments.run), arguments.out)
    if arguments.scaling:
        sweeps(read_csv(arguments.scaling), arguments.out)


if __name__ == "__main__":
    main()
