"""Nothing for nothing: what each effect of a picture costs, and what is saved where a scene does not call for it.

For each scene the plans take turns: the minimal one, the same again (the noise), the minimal one with each effect that the scene
does not call for forced on, with each that it does call for left out, and all effects at once. What is forced on changes no bit,
which is checked; what is left out makes another picture, which is the point of it.

On the CPU a call of `render` is timed, by one thread, so that a nanosecond a covered pixel is one of a core's. On a GPU it is the
operator `draw`, from vertices in clip space to the picture, replayed as a CUDA graph; a covered pixel then costs picoseconds.

    python bench/effects.py --csv bench/results/effects_cpu.csv --docs docs/effects.md --plot docs/img/effects.png
    python bench/effects.py --quick
    python bench/effects.py --device cuda --csv build/effects.csv
    python bench/effects.py --scenes Duck.glb,bunny.ply,Rcourtyard
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import markdown
import numpy as np
import picture_scenes
import torch
from picture_scenes import Pictured

from bigtri import ModelWarning, native, render
from bigtri.app import arguments as option_types
from bigtri.scene.plan import EVERYTHING, RenderPlan, plan_for
from bigtri.study import benchmark, provenance
from bigtri.study.clock import interleaved, setting, summary

QUICK = ("R16k-textured", "Rcourtyard")
MINIMAL, AGAIN, ALL = "minimal", "again", "everything"


@dataclasses.dataclass
class Row:
    """One plan of one scene; the fields are the CSV's columns."""

    scene: str
    triangles: int
    plan: str  # "minimal", "again", "everything", "with EFFECT" or "without EFFECT"
    width: int  # px
    height: int  # px
    threads: int  # 0 on a GPU
    isa: str  # "cuda" on a GPU
    covered_px: int
    ms_median: float
    ms_min: float
    ms_p25: float
    ms_p75: float
    repeats: int
    ns_more: float  # a covered pixel, beside the minimal plan: median of the rounds
    ns_more_p25: float
    ns_more_p75: float
    ratio: float  # time over that of the minimal plan
    device: str = dataclasses.field(default_factory=provenance.device)
    versions: str = dataclasses.field(default_factory=provenance.versions)
    commit: str = dataclasses.field(default_factory=provenance.commit)
    command: str = dataclasses.field(default_factory=provenance.command)


def plans_of(minimal: RenderPlan) -> dict[str, RenderPlan]:
    """What takes turns, by name."""
    plans = {MINIMAL: minimal, AGAIN: minimal}
    for name, on in vars(minimal).items():
        spoken = name.replace("_", " ")
        plans[f"{'without' if on else 'with'} {spoken}"] = dataclasses.replace(minimal, **{name: not on})
    return plans | {ALL: EVERYTHING}


class Case(NamedTuple):
    """A scene on the device that draws it."""

    pictured: Pictured
    width: int  # px
    height: int  # px
    device: torch.device

    def calls(self, plans: dict[str, RenderPlan], expected: torch.Tensor) -> dict[str, Callable[[], object]]:
        """What draws the picture by each plan.

        Raises:
            AssertionError: a plan that leaves nothing out gives another picture.
        """
        size, camera = (self.height, self.width), self.pictured.camera(self.width / self.height)
        scene = self.pictured.scene.on(self.device.type)
        calls: dict[str, Callable[[], object]] = {}
        # On a GPU all plans draw into the same memory: where it lies moves a time by a few per cent.
        target = None
        if self.device.type == "cuda":
            target = picture_scenes.target(self.pictured.scene, [camera], size, EVERYTHING, 1, "exact", self.device)
        for name, plan in plans.items():
            if target is None:
                calls[name] = functools.partial(render, scene, camera, size, backend="native", plan=plan)
                image = render(scene, camera, size, backend="native", plan=plan)
            else:
                planned = target._replace(surface=scene.surface(plan, self.pictured.scene.background))
                calls[name] = planned.draw
                planned.draw()
                image = target.image[0].cpu()
            if not name.startswith("without") and not torch.equal(image, expected):
                raise AssertionError(f"{self.pictured.name}: plan {name!r} gives another picture")
        return calls


def measure(case: Case, threads: int, seconds: float) -> list[Row]:
    """Times all plans of a scene, about `seconds` in all, and prints a line for each."""
    pictured, width, height, device = case
    plans = plans_of(plan_for(pictured.scene))
    on_gpu = device.type == "cuda"
    with setting(threads):
        camera, size = pictured.camera(width / height), (height, width)
        expected, buffers = render(pictured.scene.on("cpu"), camera, size, backend="native", return_buffers=True)
        covered = int((buffers.visibility.triangle >= 0).sum())
        calls = case.calls(plans, expected)
        times = {name: np.array(ms) for name, ms in interleaved(calls, seconds, device=device.type).items()}
    rows = []
    for name, ms in times.items():
        low, more, high = np.percentile(ms - times[MINIMAL], [25, 50, 75]) * 1e6 / covered
        ratio = float(np.median(ms / times[MINIMAL]))
        who = (0, "cuda") if on_gpu else (threads, native.isa())
        named = (pictured.name, len(pictured.scene.triangles), name, width, height, *who, covered)
        rows.append(
            Row(*named, *summary(ms.tolist()), float(more), float(low), float(high), ratio, provenance.device(device.type))
        )
        print(
            f"{pictured.name:18} {name:24} {rows[-1].ms_median:9.4f} {more:9.4f} ({low:.4f} to {high:.4f}) {ratio:6.3f}",
            flush=True,
        )
    return rows


def effect_of(row: Row) -> str:
    """The effect that a plan has, or lacks, beside the minimal one; else the plan."""
    return row.plan.removeprefix("without ").removeprefix("with ")


def cell(row: Row) -> str:
    """A figure of the table: what leaving out an effect that is called for saves, in bold, or what forcing it on costs."""
    more = -row.ns_more if row.plan.startswith("without") else row.ns_more
    text = f"{1e3 * more:.1f}" if row.isa == "cuda" else f"{more:.2f}"
    return f"**{text}**" if row.plan.startswith("without") else text


def table(rows: list[Row]) -> str:
    effects = list(dict.fromkeys(effect_of(row) for row in rows if row.plan != MINIMAL))
    lines = []
    for name in dict.fromkeys(row.scene for row in rows):
        of = {effect_of(row): row for row in rows if row.scene == name}
        minimal = of[MINIMAL].ms_median * (1e3 if of[MINIMAL].isa == "cuda" else 1)
        lines.append([name, f"{minimal:.3g}", of[MINIMAL].covered_px, *(cell(of[effect]) for effect in effects)])
        lines[-1].append(f"{100 * (1 - 1 / of[ALL].ratio):.1f} %")
    heads = [{AGAIN: "A/A", ALL: "all on"}.get(effect, effect) for effect in effects]
    unit = "us" if rows[0].isa == "cuda" else "ms"
    return markdown.table(["", f"minimal, {unit}", "covered px", *heads, "saved"], lines)


def plot(rows: list[Row], path: Path) -> None:
    """A panel for each scene: what each effect costs a covered pixel, quartiles as whiskers."""
    from plot import COLORS, caption, plt, save

    scale, unit = (1e3, "ps") if rows[0].isa == "cuda" else (1, "ns")
    names = list(dict.fromkeys(row.scene for row in rows))
    figure, panels = plt.subplots(1, len(names), figsize=(2.2 + 1.9 * len(names), 3.6), sharey=True, sharex=True, squeeze=False)
    for axes, name in zip(panels[0], names, strict=True):
        shown = [row for row in rows if row.scene == name and row.plan != MINIMAL][::-1]
        sign = [-1 if row.plan.startswith("without") else 1 for row in shown]
        ns = [scale * s * row.ns_more for s, row in zip(sign, shown, strict=True)]
        reach = [[scale * abs(row.ns_more - p) for row, p in zip(shown, ps, strict=True)] for ps in quartiles(shown, sign)]
        colors = [COLORS["bigtri"] if s < 0 else COLORS["llvmpipe"] for s in sign]
        axes.barh([effect_of(row) for row in shown], ns, xerr=reach, color=colors, capsize=2)
        axes.set_title(name, loc="left", size=9)
        axes.grid(axis="x", alpha=0.3)
        axes.set_axisbelow(True)
    panels[0, 0].set_xlabel(f"{unit} a covered pixel")
    handles = [plt.Rectangle((0, 0), 1, 1, color=COLORS[key]) for key in ("bigtri", "llvmpipe")]
    figure.legend(
        handles, ["called for: what it costs", "forced on: what it would cost"], frameon=False, ncols=2, loc="upper right"
    )
    caption(figure, {key: str(value) for key, value in vars(rows[0]).items()})
    save(figure, path, top=0.93)


def quartiles(rows: list[Row], sign: list[int]) -> list[list[float]]:
    """The lower and the upper end of each whisker."""
    ends = [(row.ns_more_p25, row.ns_more_p75)[::s] for row, s in zip(rows, sign, strict=True)]
    return [list(end) for end in zip(*ends, strict=True)]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--quick", action="store_true", help="two scenes, two seconds each")
    parser.add_argument("--scenes", help=f"names and model files (default {','.join(picture_scenes.DEFAULT)})")
    parser.add_argument("--size", type=option_types.size, default="1080p", help="default 1080p")
    parser.add_argument("--threads", type=option_types.count, default=1, help="of the CPU (default 1)")
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu", help="default cpu")
    parser.add_argument("--seconds", type=option_types.seconds, help="time for each scene (default 15; quick 2)")
    parser.add_argument("--csv", metavar="FILE", type=option_types.csv_file, help="write the rows there")
    parser.add_argument(
        "--docs", metavar="PAGE", type=Path, help="put the table between this page's markers 'effects' or 'effects cuda'"
    )
    parser.add_argument("--plot", metavar="FILE", type=Path, help="draw a picture of it (wants matplotlib)")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore", ModelWarning)
    warnings.filterwarnings("ignore", "bigtri.render: plan leaves out", UserWarning)
    names = arguments.scenes.split(",") if arguments.scenes else list(QUICK if arguments.quick else picture_scenes.DEFAULT)
    print(f"{provenance.device()}; {provenance.versions()}; {provenance.commit()}; {native.isa()}")
    print(f"{'scene':18} {'plan':24} {'median ms':>9} {'ns more a covered pixel (quartiles)':>20}  times minimal")
    rows: list[Row] = []
    width, height = arguments.size
    if arguments.device not in native.devices():
        parser.error(f"--device cuda: no GPU, or the extension is not built for CUDA (devices: {', '.join(native.devices())})")
    device = torch.device(arguments.device)
    seconds = arguments.seconds or (2.0 if arguments.quick else 15.0)
    for name in names:
        try:
            pictured = picture_scenes.make(name)
        except ValueError as error:
            parser.error(str(error))
        rows += measure(Case(pictured, width, height, device), arguments.threads, seconds)
        if arguments.csv:
            benchmark.write_csv(arguments.csv, rows)
    text = table(rows)
    print(f"\n{text}")
    if arguments.docs:
        markdown.paste(arguments.docs, "effects cuda" if arguments.device == "cuda" else "effects", text)
    if arguments.plot:
        plot(rows, arguments.plot)


if __name__ == "__main__":
    main()
