"""What is said to people, as data: a code with its values; a sentence of each language is only its rendering.

The English sentences of the drivers are beside them, in `texts.toml` of each family, which may have other languages
too, each in a table of its own, such as `[de]`; whoever uses drivers adds the rest: see `add_texts`. In the braces of a
sentence stands the name of a value, and after a colon how it is written:

{n}           as it is; a text in a text in the same language, a list with commas
{um:.1f}      a number in the form of Python, with the language's decimal sign
{all:list}    a list with semicolons
{n:|one|many} the first words of exactly one, else the second, in which # is the number
{at:minute}   a time, UTC, to the minute; {at:clock} only the time of day
{ago:lasting} a number of seconds as hours, minutes and seconds
{why:why}     a word of the group `why` of the same file; a word that is not there stands as it is

The English sentence that is logged, stored and published for people who read it raw has the published words themselves.
"""

import re
import tomllib
from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import Final, TypeAlias

Value: TypeAlias = "str | int | float | datetime | Sequence[str] | Text | None"
"""A value of a text. A text may contain others."""

_PLACE: Final = re.compile(r"\{(\w+)(?::([^{}]*))?\}")
_DEEPEST = 9
_NO_VALUE = "-"
_FOLDERS: Final[list[Traversable]] = []


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
        return text_from(english(code, values), str(code), values)

    def __reduce__(self) -> tuple[object, tuple[str, str, dict[str, Value]]]:
        return text_from, (str(self), self.code, dict(self.values))

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
        return filled(texts(language).get(f"{group}.{self.code}", ""), self.values, language)


def text_from(written: str, code: str, values: Mapping[str, Value]) -> Text:
    """The text that was written with this code and these values."""
    made = str.__new__(Text, written)
    made.code, made.values = code, values
    return made


def plain(written: str) -> Text:
    """Words of others."""
    return written if isinstance(written, Text) else text_from(written, "", {})


def shown(value: object) -> str:
    """A value as it would be written in the file, shortened when long."""
    if isinstance(value, bool):
        return str(value).lower()
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


NOTHING: Final = plain("")
"""Nothing is said."""


def text_of(error: BaseException) -> Text:
    """What an exception says; with its code if it was raised with a text."""
    return error.args[0] if error.args and isinstance(error.args[0], Text) else plain(str(error))


def add_texts(folder: Traversable) -> None:
    """Also read `en.toml` and the files of other languages in this folder."""
    _FOLDERS.append(folder)
    texts.cache_clear()


@cache
def texts(language: str) -> Mapping[str, str]:
    """Every text of a language, by `group.key`. Raises OSError for a language without a file."""
    found: dict[str, str] = {}
    for file in _of_drivers():
        table = _tables(file).get("text" if language == "en" else language, {})
        found.update((f"text.{key}", text) for key, text in table.items())
    for folder in _FOLDERS:
        for group, table in _tables(folder.joinpath(f"{language}.toml")).items():
            found.update((f"{group}.{key}", text) for key, text in table.items())
    return found


def _tables(file: Traversable) -> Mapping[str, Mapping[str, str]]:
    return tomllib.loads(file.read_text(encoding="utf-8"))


def _of_drivers() -> list[Traversable]:
    here = files("drivers")
    beside = (folder.joinpath("texts.toml") for folder in (here, *here.iterdir()) if folder.is_dir())
    return [file for file in beside if file.is_file()]


def english(code: str, values: Mapping[str, Value]) -> str:
    """The sentence of a code, with the published words; an unknown code with its values."""
    template = texts("en").get(f"text.{code}")
    if template is None:
        return ", ".join([code, *(f"{name} {value}" for name, value in values.items())])
    return filled(template, values, "en", words=False)


def filled(template: str, values: Mapping[str, Value], language: str, *, words: bool = True, depth: int = 0) -> str:
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
        return filled(template, value.values, language, depth=depth + 1)
    if form in ("minute", "clock"):
        return _time(value, form)
    if isinstance(value, str):
        return texts(language).get(f"{form}.{value}", str(value)) if form and words else str(value)
    if isinstance(value, int | float):
        return number_in(value, form, language)
    if value is None or isinstance(value, datetime):
        return _NO_VALUE if value is None else str(value)
    return ("; " if form == "list" else ", ").join(_written(each, form, language, words, depth) for each in value)


def number_in(value: float, form: str, language: str) -> str:
    """A number in one of the forms above."""
    if form.startswith("|"):
        _, one, many = f"{form}|".split("|")[:3]
        return one if value == 1 else many.replace("#", number_in(value, "", language))
    if form == "lasting":
        return str(timedelta(seconds=round(value)))
    try:
        made = format(value, form)
    except ValueError:  # another type than the sentence expects
        made = str(value)
    return made.replace(".", texts(language).get("language.decimal", "."))


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
