"""What is said to people, as data: a code with its values; a sentence of each language is only its rendering.

The sentences are in `texts/LANGUAGE.toml`, one file for each language, with everything else that people read. In the
braces of a sentence stands the name of a value, and after a colon how it is written:

{n}           as it is; a text in a text in the same language, a list with commas
{um:.1f}      a number in the form of Python, with the language's decimal sign
{n:|one|many} the first words of exactly one, else the second, in which # is the number
{at:minute}   a time, UTC, to the minute; {at:clock} only the time of day
{ago:lasting} a number of seconds as hours, minutes and seconds
{why:why}     a word of the group `why` of the same file; a word that is not there stands as it is

The English sentence that is logged, stored and published for people who read it raw has the published words themselves.
"""

import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import cache
from importlib.resources import files
from typing import Any, Final, TypeAlias

Value: TypeAlias = "str | int | float | datetime | Sequence[str] | Text | None"
"""A value of a text. A text may contain others."""

_FOLDER: Final = files("gateway.model").joinpath("texts")
_PLACE: Final = re.compile(r"\{(\w+)(?::([^{}]*))?\}")
_DEEPEST = 5
_NO_VALUE = "-"


class Text(str):
    """A sentence in English that knows its code and values. As a string it is that sentence, for those who read it raw.

    Parameters
    ----------
    code: of NoticeCode, or of talc.kinds.EventCode
    values: what the sentence contains
    """

    __slots__ = ("code", "values")
    code: str
    """Empty: words of others, or of a program that had no codes; they are shown as they are."""
    values: Mapping[str, Value]

    def __new__(cls, code: str, /, **values: Value) -> "Text":
        return _made(_raw(code, values), str(code), values)

    def __reduce__(self) -> tuple[object, tuple[str, str, dict[str, Value]]]:
        return _made, (str(self), self.code, dict(self.values))

    def says(self, code: str) -> bool:
        """Whether it says this, alone or within another text."""
        return self.code == code or any(isinstance(v, Text) and v.says(code) for v in self.values.values())

    def value_of(self, name: str) -> Value:
        """The value of this name, also of a text within it; None: there is none."""
        if name in self.values:
            return self.values[name]
        inner = (value.value_of(name) for value in self.values.values() if isinstance(value, Text))
        return next((value for value in inner if value is not None), None)

    def having(self, name: str, value: Value) -> "Text":
        """The same with another value of this name, also of a text within it."""
        if not self.code:
            return self
        values = {
            n: value if n == name else v.having(name, value) if isinstance(v, Text) else v
            for n, v in self.values.items()
        }
        return Text(self.code, **values)

    def in_language(self, language: str) -> str:
        """Its sentence. One whose code this program does not know stays as it is."""
        return self.about("text", language) or str(self)

    def about(self, group: str, language: str) -> str:
        """What another group of the catalogue has for its code: `matters`, why it matters; `remedy`, what to do.

        Empty: nothing.
        """
        return _filled(texts(language).get(f"{group}.{self.code}", ""), self.values, language)


def _made(written: str, code: str, values: Mapping[str, Value]) -> Text:
    made = str.__new__(Text, written)
    made.code, made.values = code, values
    return made


def plain(written: str) -> Text:
    """Words of others."""
    return written if isinstance(written, Text) else _made(written, "", {})


NOTHING: Final = plain("")
"""Nothing is said."""


def text_of(error: BaseException) -> Text:
    """What an exception says; with its code if it was raised with a text."""
    return error.args[0] if error.args and isinstance(error.args[0], Text) else plain(str(error))


def failure(error: BaseException) -> Text:
    """What a driver or a library says went wrong, with the kind of the error."""
    found = text_of(error)
    return found if found.code else Text("failed", kind=type(error).__name__, error=str(error))


def restored(written: str, code: str, values: Mapping[str, Any]) -> Text:
    """A text from what was published or stored of it; see `values_of`."""
    return _made(written, code, {name: _restored(value) for name, value in values.items()})


def _restored(value: Any) -> Value:
    if isinstance(value, dict):
        code, values = value.get("code"), value.get("values")
        if isinstance(code, str) and isinstance(values, dict):
            inner = {str(name): _restored(each) for name, each in values.items()}
            return _made(_raw(code, inner), code, inner)
        return str(value)
    if isinstance(value, list):
        return [str(each) for each in value]
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
            return [str(each) for each in value]


# The catalogue ------------------------------------------------------------------------------------------------------


@cache
def languages() -> Mapping[str, str]:
    """Code of each language to its own name; the first, English, is for whoever asks for none of them."""
    found = {file.name.removesuffix(".toml") for file in _FOLDER.iterdir() if file.name.endswith(".toml")}
    return {code: texts(code)["language.name"] for code in sorted(found, key=lambda code: (code != "en", code))}


@cache
def texts(language: str) -> Mapping[str, str]:
    """Every text of a language, by `group.key`. Raises OSError for a language without a file."""
    found: dict[str, str] = {}
    for group, table in tomllib.loads(_FOLDER.joinpath(f"{language}.toml").read_text(encoding="utf-8")).items():
        found.update((f"{group}.{key}", text) for key, text in table.items())
    return found


@dataclass(frozen=True, slots=True)
class Language:
    """What programs write around the texts that have a code."""

    code: str = "en"

    def __call__(self, key: str, /, **values: Value) -> str:
        """The text of a `group.key`, with its values. Raises KeyError."""
        return _filled(texts(self.code)[key], values, self.code)

    def number(self, value: float, form: str) -> str:
        """In a form of Python, with the language's decimal sign."""
        return _number(value, form, self.code)

    def word(self, group: str, published: str) -> str:
        """A published word; one that is not in the group as it is."""
        return texts(self.code).get(f"{group}.{published}", published)

    def of(self, text: str) -> str:
        """What somebody says; words of others as they are."""
        return text.in_language(self.code) if isinstance(text, Text) else text


def language_wanted(environment: Mapping[str, str]) -> str:
    """The language of a terminal, by LC_ALL, LC_MESSAGES or LANG; English if it is one without a file."""
    wanted = next((found for name in ("LC_ALL", "LC_MESSAGES", "LANG") if (found := environment.get(name))), "")
    code = re.split(r"[_.@-]", wanted.lower())[0]
    return code if code in languages() else "en"


def _raw(code: str, values: Mapping[str, Value]) -> str:
    template = texts("en").get(f"text.{code}")
    if template is None:
        return ", ".join([code, *(f"{name} {value}" for name, value in values.items())])
    return _filled(template, values, "en", words=False)


def _filled(template: str, values: Mapping[str, Value], language: str, *, words: bool = True, depth: int = 0) -> str:
    """A sentence with its values. What is missing is left as it stands: a wrong text must not stop who says it.

    words: write those of a group as the catalogue has them; otherwise as they are published
    """

    def place(found: re.Match[str]) -> str:
        name, form = found[1], found[2] or ""
        return _written(values[name], form, language, words, depth) if name in values else found[0]

    return _PLACE.sub(place, template)


def _written(value: Value, form: str, language: str, words: bool, depth: int) -> str:
    if isinstance(value, Text):
        template = texts(language).get(f"text.{value.code}")
        if not words or depth >= _DEEPEST or template is None:
            return str(value)
        return _filled(template, value.values, language, depth=depth + 1)
    if form in ("minute", "clock"):
        return _time(value, form)
    if isinstance(value, str):
        return texts(language).get(f"{form}.{value}", str(value)) if form and words else str(value)
    if isinstance(value, int | float):
        return _number(value, form, language)
    return _NO_VALUE if value is None else str(value) if isinstance(value, datetime) else ", ".join(value)


def _number(value: float, form: str, language: str) -> str:
    if form.startswith("|"):
        _, one, many = f"{form}|".split("|")[:3]
        return one if value == 1 else many.replace("#", _number(value, "", language))
    if form == "lasting":
        return str(timedelta(seconds=round(value)))
    try:
        made = format(value, form)
    except ValueError:  # another type than the sentence expects
        made = str(value)
    return made.replace(".", texts(language)["language.decimal"])


def _time(value: Value, form: str) -> str:
    try:
        at = value if isinstance(value, datetime) else datetime.fromisoformat(str(value))
    except ValueError:
        return str(value)
    return f"{at:%Y-%m-%d %H:%M} UTC" if form == "minute" else f"{at:%H:%M:%S} UTC"


def places(template: str) -> Mapping[str, frozenset[str]]:
    """The names of the values in a sentence, and their forms."""
    found: dict[str, set[str]] = {}
    for place in _PLACE.finditer(template):
        found.setdefault(place[1], set()).add(place[2] or "")
    return {name: frozenset(forms) for name, forms in found.items()}
