"""Values of the JSON by their keys, checked. What is wrong is said with its place."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from typing import Any

from ..model import ModelError

_INT32 = 2**31 - 1


class JsonObject:
    """An object of the JSON.

    A key that is missing gives the default. Every method raises a ModelError where a value is not as the method says.

    Attributes:
        place: where it stands, for error texts, such as "accessors[3]"; "" for the whole.
    """

    def __init__(self, value: Any, place: str = "") -> None:
        if not isinstance(value, dict):
            raise ModelError(f"{place or 'the JSON'} must be an object, got {shown(value)}")
        self._value = value
        self.place = place

    def __contains__(self, key: str) -> bool:
        return key in self._value

    def __iter__(self) -> Iterator[str]:
        return iter(self._value)

    def at(self, key: str) -> str:
        """The place of a key's value."""
        return f"{self.place}.{key}" if self.place else key

    def text(self, key: str, default: str = "") -> str:
        value = self._value.get(key, default)
        return value if isinstance(value, str) else self._refuse(key, "text")

    def flag(self, key: str, default: bool = False) -> bool:
        value = self._value.get(key, default)
        return value if isinstance(value, bool) else self._refuse(key, "true or false")

    def whole(self, key: str, default: int | None = None, low: int = 0, high: int = _INT32) -> int:
        """A whole number from ``low`` to ``high``; without a default there must be one."""
        value: Any = self._value.get(key, default)
        # Some writers put 4.0 for 4.
        if isinstance(value, float) and value.is_integer():
            value = int(value)
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            wanted = f"of at least {low}" if high == _INT32 else f"from {low} to {high}"
            self._refuse(key, f"a whole number {wanted}")
        return value

    def chosen(self, key: str, allowed: tuple[int, ...], default: int | None = None) -> int:
        """One of some numbers, as glTF names its constants."""
        value: Any = self._value.get(key, default)
        if isinstance(value, bool) or value not in allowed:
            self._refuse(key, f"one of {', '.join(map(str, allowed))}")
        return value

    def number(self, key: str, default: float) -> float:
        value = self._value.get(key, default)
        return float(value) if _is_number(value) else self._refuse(key, "a finite number")

    def numbers(self, key: str, default: tuple[float, ...]) -> tuple[float, ...]:
        """As many finite numbers as the default has."""
        value = self._value.get(key)
        if value is None:
            return default
        if not (isinstance(value, list) and len(value) == len(default) and all(map(_is_number, value))):
            self._refuse(key, f"{len(default)} finite numbers")
        return tuple(map(float, value))

    def weights(self, key: str) -> tuple[float, ...] | None:
        """Any number of finite numbers, or None."""
        value = self._value.get(key)
        if value is None:
            return None
        if not (isinstance(value, list) and all(map(_is_number, value))):
            self._refuse(key, "a list of finite numbers")
        return tuple(map(float, value))

    def texts(self, key: str) -> list[str]:
        value = self._value.get(key, [])
        if not (isinstance(value, list) and all(isinstance(item, str) for item in value)):
            self._refuse(key, "a list of texts")
        return value

    def indices(self, key: str, count: int, of: str) -> list[int]:
        """A list of indices into ``count`` of something."""
        value = self._value.get(key, [])
        if not isinstance(value, list):
            self._refuse(key, "a list of indices")
        return [JsonObject({key: item}, self.place).index(key, count, of) for item in value]

    def index(self, key: str, count: int, of: str) -> int:
        """An index into ``count`` of something."""
        value: Any = self._value.get(key)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < count:
            self._refuse(key, f"an index into the {count} {of}")
        return value

    def object(self, key: str) -> JsonObject:
        """An object; a missing one is empty."""
        return JsonObject(self._value.get(key, {}), self.at(key))

    def objects(self, key: str) -> list[JsonObject]:
        value = self._value.get(key, [])
        if not isinstance(value, list):
            self._refuse(key, "a list of objects")
        return [JsonObject(item, f"{self.at(key)}[{i}]") for i, item in enumerate(value)]

    def extension(self, name: str) -> JsonObject | None:
        extensions = self.object("extensions")
        return extensions.object(name) if name in extensions else None

    def _refuse(self, key: str, wanted: str) -> Any:
        got = shown(self._value[key]) if key in self._value else "nothing"
        raise ModelError(f"{self.at(key)} must be {wanted}, got {got}")


def shown(value: Any) -> str:
    """A value of the JSON for an error text, cut where it is long."""
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _is_number(value: Any) -> bool:
    try:
        return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:  # an integer beyond float64
        return False
