"""How much work each variant does, from what the stages say: the oracle of the counters of csrc/core/counters.h."""

from collections.abc import Callable
from importlib import import_module
from pkgutil import iter_modules

from ...precision import Arithmetic
from ..records import Records

# By the variant's name, which is its module's: a function of (records, arithmetic) that returns what it counts, by the
# counter's name.
COUNTS: dict[str, Callable[[Records, Arithmetic], dict[str, int]]] = {
    module.name: import_module(f"{__name__}.{module.name}").count for module in iter_modules(__path__)
}

__all__ = ["COUNTS"]
