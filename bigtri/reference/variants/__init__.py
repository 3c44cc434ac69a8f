"""How much work each variant does, from what the stages say: the oracle of the counters of csrc/core/counters.h."""

from importlib import import_module
from pkgutil import iter_modules
from typing import Protocol

from ..work import Job


class Model(Protocol):
    """What a module of this package has; its name is the variant's."""

    STANDARD: dict[str, int]  # what its parameters are by default
    # The parameter that, at 0, makes it draw what depth shows to be of no use; empty if it leaves nothing out in an order that
    # threads decide.
    REJECTS_BY_DEPTH: str
    OWNS_PIXELS: bool  # whether a pixel is one task's, which stores it; else many offer it fragments with an atomic minimum

    def count(self, job: Job) -> dict[str, int]:
        """What the variant counts in one view, by the counter's name, drawn by one thread; adds to ``job.places``."""


MODELS: dict[str, Model] = {module.name: import_module(f"{__name__}.{module.name}") for module in iter_modules(__path__)}

__all__ = ["MODELS", "Model"]
