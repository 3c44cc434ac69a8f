"""The fastest way to draw a scene: variants, and their parameters one after the other. `bigtri tune` is the command.

Every variant draws the scene; what takes more than twice as long as the fastest is out. Of each other variant the parameters
are tried in turn: the values that it allows, or steps of a factor of four from the standard one for as long as they gain. At
the end the standard way and the best ones take turns, and each picture is compared with the standard one's in bits.
"""

from __future__ import annotations

import datetime
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import NamedTuple

import numpy as np
import torch

from .. import native
from ..ops.rasterize import rasterize
from ..ops.tuned import Measured, Way
from ..precision import DEFAULT
from .clock import interleaved

LOST = 2  # times the fastest way: what takes longer is not tried further
GAIN = 0.97  # of the time before: what a step in a parameter has to come to
STEP = 4
ALL = 16  # values that are all tried, where a parameter has no more
FROM = 64  # where the steps begin for a parameter whose standard, 0, means that the variant chooses
FINALISTS = 8  # beside the standard way; more where there are more variants
TURNS = 5  # of each way while parameters are tried


class Job(NamedTuple):
    """A scene, and how it is drawn."""

    name: str
    positions: torch.Tensor  # [V, 4] or [B, V, 4], on the device that draws
    triangles: torch.Tensor  # [T, 3]
    resolution: tuple[int, int]  # height, width, px
    precision: str = DEFAULT

    @property
    def device(self) -> str:
        return self.positions.device.type

    def views(self) -> int:
        return len(self.positions) if self.positions.ndim == 3 else 1


class Setting(NamedTuple):
    """A way that is tried."""

    variant: str
    parameters: tuple[tuple[str, int], ...] = ()  # those that are not standard, sorted

    def given(self, parameter: native.Parameter) -> int:
        return dict(self.parameters).get(parameter.name, parameter.standard)

    def changed(self, parameter: native.Parameter, value: int) -> Setting:
        rest = dict(self.parameters) | {parameter.name: value}
        if value == parameter.standard:
            del rest[parameter.name]
        return Setting(self.variant, tuple(sorted(rest.items())))


def tune(job: Job, seconds: float, say: Callable[[str], None] = lambda line: None) -> Measured:
    """Measure; the standard way comes first, then the others that took part in the end, fastest first.

    Args:
        seconds: for the turns at the end. What comes before takes some times as long.
        say: is told what goes on.

    Raises:
        RuntimeError: a way has drawn other bits, which would be a defect.
    """
    return _Search(job, seconds, say).run()


class _Search:
    def __init__(self, job: Job, seconds: float, say: Callable[[str], None]) -> None:
        self.job, self.seconds, self.say = job, seconds, say
        views = job.positions.shape[:-2]
        self.out = torch.empty((*views, *job.resolution), dtype=torch.int64, device=job.positions.device)

    def run(self) -> Measured:
        variants = native.REGISTRY[self.job.device][self.job.precision]
        standard = Setting(next(iter(variants)))
        expected = self.picture(standard).clone()
        self.say("variants")
        first = self.times(map(Setting, variants), 3)
        fastest = min(first.values())
        tried: dict[Setting, float] = {}
        for setting, us in first.items():
            tried[setting] = us
            if us <= LOST * fastest:
                tried |= self.descent(setting, variants[setting.variant].parameters.values())
        best = finalists(tried, standard)
        self.say("turns")
        rounds = self.turns(best, self.seconds, 9)
        middle = {setting: float(np.median(us)) for setting, us in rounds.items()}
        for setting in best:
            if not torch.equal(self.picture(setting), expected):
                what = f"variant {setting.variant!r} with {dict(setting.parameters)}"
                raise RuntimeError(f"bigtri.tune: {what} has drawn other bits, which is a defect")
        ways = [
            Way(s.variant, dict(s.parameters), middle[s], float(np.percentile(rounds[s] / rounds[standard], 75)))
            for s in sorted(best, key=lambda s: (s != standard, middle[s]))
        ]
        height, width = self.job.resolution
        on_cpu = self.job.device == "cpu"
        return Measured(
            scene=self.job.name,
            precision=self.job.precision,
            width=width,
            height=height,
            views=self.job.views(),
            triangles=len(self.job.triangles),
            threads=torch.get_num_threads() if on_cpu else 0,
            isa=native.isa() if on_cpu else "",
            date=datetime.date.today().isoformat(),
            ways=ways,
        )

    def descent(self, start: Setting, parameters: Iterable[native.Parameter]) -> dict[Setting, float]:
        """What was tried from there, with its microseconds: one parameter after the other, each from the best so far."""
        tried: dict[Setting, float] = {}
        here = start
        for parameter in parameters:
            self.say(f"{start.variant}: {parameter.name}")
            for values in lines(parameter, here.given(parameter)):
                for value in values:
                    there = here.changed(parameter, value)
                    us = self.times([here, there], TURNS)
                    tried |= us
                    if there not in us or us[there] > GAIN * us[here]:
                        break
                    here = there
        return tried

    def times(self, settings: Iterable[Setting], turns: int) -> dict[Setting, float]:
        """Median microseconds; without those that the device has not the memory for, or that take too long to go on."""
        able: list[Setting] = []
        fastest = float("inf")
        for setting in settings:
            try:
                once = float(np.median(self.turns([setting], 0, 1)[setting]))
            except (RuntimeError, MemoryError):
                continue
            fastest = min(fastest, once)
            if once <= 2 * LOST * fastest:  # a single turn says no more
                able.append(setting)
        return {setting: float(np.median(us)) for setting, us in self.turns(able, 0, turns).items()}

    def turns(self, settings: Iterable[Setting], seconds: float, at_least: int) -> Mapping[Setting, np.ndarray]:
        """Microseconds [round] of each."""
        ordered = list(settings)
        calls = {str(number): partial(self.picture, setting) for number, setting in enumerate(ordered)}
        ms = interleaved(calls, seconds, at_least, device=self.job.device)
        return {setting: np.array(ms[str(number)]) * 1e3 for number, setting in enumerate(ordered)}

    def picture(self, setting: Setting) -> torch.Tensor:
        rasterize(
            self.job.positions,
            self.job.triangles,
            self.job.resolution,
            backend="native",
            variant=setting.variant,
            precision=self.job.precision,
            parameters=dict(setting.parameters),
            depth=False,
            out=self.out,
        )
        return self.out


def finalists(tried: Mapping[Setting, float], standard: Setting) -> list[Setting]:
    """Of what was tried, with its microseconds: the standard way, the best of each variant, and the best of the others."""
    fastest_first = sorted(tried, key=lambda setting: tried[setting])
    chosen = [standard]
    for setting in fastest_first:
        if setting.variant not in {other.variant for other in chosen[1:]} and setting != standard:
            chosen.append(setting)
    rest = [setting for setting in fastest_first if setting not in chosen]
    return chosen + rest[: max(0, FINALISTS + 1 - len(chosen))]


def lines(parameter: native.Parameter, here: int) -> list[list[int]]:
    """Values to try, in lists; the rest of a list is left where a value gains nothing."""
    if parameter.only or parameter.high - parameter.low < ALL:
        return [[value] for value in parameter.only or range(parameter.low, parameter.high + 1) if value != here]
    up, down = [], []
    value = here * STEP if here else FROM
    while value <= parameter.high:
        up.append(value)
        value *= STEP
    value = here // STEP
    while value >= max(parameter.low, 1):
        down.append(value)
        value //= STEP
    return [up, down] if here else [[value] for value in up[:3]]
