"""The catalogue: every sentence in each language, one file `texts/LANGUAGE.toml` with everything that people read.

The drivers' own English sentences are beside them (drivers/text.py, which also says how values are written).
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from functools import cache
from importlib.resources import files
from typing import Any, Final

from drivers import text as sentences
from drivers.base import DriverError
from drivers.text import NOTHING, Text, Value, english, filled, number_in, places, plain, text_from, text_of, texts

__all__ = [
    "NOTHING", "Language", "Text", "Value", "failure", "json_of", "json_text", "language_wanted", "languages", "places",
    "plain", "restored", "text_of", "texts", "values_of",
]  # fmt: skip

_FOLDER: Final = files("gateway.model").joinpath("texts")
sentences.add_texts(_FOLDER)


def failure(error: BaseException) -> Text:
    """What a driver or a library says went wrong, with the kind of the error."""
    found = text_of(error)
    of_driver = isinstance(error, DriverError)
    return found if found.code and not of_driver else Text("failed", kind=type(error).__name__, error=found)


def restored(written: str, code: str, values: Mapping[str, Any]) -> Text:
    """A text from what was published or stored of it; see `values_of`."""
    return text_from(written, code, {name: _restored(value) for name, value in values.items()})


def _restored(value: Any) -> Value:
    if isinstance(value, dict):
        code, values = value.get("code"), value.get("values")
        if isinstance(code, str) and isinstance(values, dict):
            inner = {str(name): _restored(each) for name, each in values.items()}
            return text_from(english(code, inner), code, inner)
        return str(value)
    if isinstance(value, list):
        return [_restored(each) if isinstance(each, dict) else str(each) for each in value]  # type: ignore[misc]
    return value if isinstance(value, str | int | float) or value is None else str(value)


def values_of(text: str) -> tuple[str, dict[str, Any]]:
    """Code and values as JSON has them: a text within as its own `code` and `values`, a time as ISO 8601."""
    return (text.code, json_of(text.values)) if isinstance(text, Text) else ("", {})


def json_text(value: object) -> str:
    """What msgspec writes for a text. Raises TypeError for anything else."""
    if isinstance(value, Text):
        return str(value)
    raise TypeError(f"{type(value).__name__} is not JSON")


def json_of(values: Mapping[str, Value]) -> dict[str, Any]:
    """The values of a text as JSON has them."""
    return {name: _as_json(value) for name, value in values.items()}


def _as_json(value: Value) -> Any:
    match value:
        case Text():
            code, values = values_of(value)
            return {"code": code, "values": values} if code else str(value)
        case datetime():
            return value.isoformat()
        case str():
            return str(value)
        case float():
            return value if abs(value) < float("inf") else None
        case int() | None:
            return value
        case _:
            return [_as_json(each) for each in value]


@cache
def languages() -> Mapping[str, str]:
    """Code of each language to its own name; the first, English, is for whoever asks for none of them."""
    found = {file.name.removesuffix(".toml") for file in _FOLDER.iterdir() if file.name.endswith(".toml")}
    return {code: texts(code)["language.name"] for code in sorted(found, key=lambda code: (code != "en", code))}


@dataclass(frozen=True, slots=True)
class Language:
    """What programs write around the texts that have a code."""

    code: str = "en"

    def __call__(self, key: str, /, **values: Value) -> str:
        """The text of a `group.key`, with its values. Raises KeyError."""
        return filled(sentences.texts(self.code)[key], values, self.code)

    def number(self, value: float, form: str) -> str:
        """In a form of Python, with the language's decimal sign."""
        return number_in(value, form, self.code)

    def word(self, group: str, published: str) -> str:
        """A published word; one that is not in the group as it is."""
        return sentences.texts(self.code).get(f"{group}.{published}", published)

    def of(self, text: str) -> str:
        """What somebody says; words of others as they are."""
        return text.in_language(self.code) if isinstance(text, Text) else text


def language_wanted(environment: Mapping[str, str]) -> str:
    """The language of a terminal, by LC_ALL, LC_MESSAGES or LANG; English if it is one without a file."""
    wanted = next((found for name in ("LC_ALL", "LC_MESSAGES", "LANG") if (found := environment.get(name))), "")
    code = re.split(r"[_.@-]", wanted.lower())[0]
    return code if code in languages() else "en"
