"""Reads a TOML table strictly: every key is read with its type, and an unread key is an error."""

from collections.abc import Collection, Mapping
from difflib import get_close_matches
from math import isfinite

from drivers.base import SetupError


class Table:
    """One table of a file. Every error names the file, the dotted field, the value and what would be right."""

    def __init__(self, values: Mapping[str, object], *, file: str, path: str = "") -> None:
        self._values, self._file, self._path = dict(values), file, path
        self._asked: set[str] = set()
        self._possible: set[str] = set()

    @property
    def file(self) -> str:
        """As given by the user; paths inside count from its folder."""
        return self._file

    def error(self, key: str, problem: str) -> SetupError:
        return SetupError(f"{self._file}: {self._path}{key}: {problem}")

    def has(self, key: str) -> bool:
        self._possible.add(key)
        return key in self._values

    def names(self) -> tuple[str, ...]:
        return tuple(self._values)

    def text(self, key: str, default: str | None = None, *, choices: Collection[str] = ()) -> str:
        value = self._take(key, default)
        if not isinstance(value, str):
            raise self.error(key, f"{value!r} is not a text")
        if choices and value not in choices:
            raise self.error(key, f"{value!r} is none of {', '.join(sorted(choices))}")
        return value

    def integer(self, key: str, default: int | None = None, *, low: int, high: int) -> int:
        value = self._take(key, default)
        if not isinstance(value, int) or isinstance(value, bool):
            raise self.error(key, f"{value!r} is not a whole number")
        if not low <= value <= high:
            raise self.error(key, f"{value} is not within {low} to {high}")
        return value

    def number(self, key: str, default: float | None = None) -> float:
        value = self._take(key, default)
        if not isinstance(value, int | float) or isinstance(value, bool):
            raise self.error(key, f"{value!r} is not a number")
        if key in self._values and not isfinite(value):
            raise self.error(key, f"{value} is not a finite number")
        return float(value)

    def texts(self, key: str, default: tuple[str, ...] | None = None) -> tuple[str, ...]:
        value = self._take(key, default)
        if not isinstance(value, list | tuple) or not all(isinstance(item, str) for item in value):
            raise self.error(key, f"{value!r} is not a list of texts")
        return tuple(value)

    def integers(self, key: str, default: tuple[int, ...] | None = None) -> tuple[int, ...]:
        value = self._take(key, default)
        if not isinstance(value, list | tuple) or not all(isinstance(i, int) and i is not True for i in value):
            raise self.error(key, f"{value!r} is not a list of whole numbers")
        return tuple(value)

    def table(self, key: str) -> "Table":
        value = self._take(key, None)
        if not isinstance(value, dict):
            raise self.error(key, f"{value!r} is not a table")
        return Table(value, file=self._file, path=f"{self._path}{key}.")

    def tables(self, key: str) -> tuple["Table", ...]:
        """An array of tables; empty when the key is absent."""
        value = self._take(key, [])
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            raise self.error(key, f"{value!r} is not a list of tables")
        return tuple(
            Table(item, file=self._file, path=f"{self._path}{key}[{number}].") for number, item in enumerate(value)
        )

    def finish(self) -> None:
        """Raise SetupError when the table holds a key that nobody asked for."""
        for key in self._values:
            if key not in self._asked:
                raise self.error(key, f"unknown key; known here: {', '.join(sorted(self._asked | self._possible))}")

    def _take(self, key: str, default: object) -> object:
        self._asked.add(key)
        if key in self._values:
            return self._values[key]
        if default is None:
            unasked = [name for name in self._values if name not in self._asked | self._possible]
            close = get_close_matches(key, unasked, n=1)
            raise self.error(key, f"missing; is {close[0]!r} meant to be it?" if close else "missing")
        return default
