"""Sentences of the page: keys of the catalogue with the numbers, times and names in them.

The browser writes them out, in its language and with its locale's numbers and times.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Final, TypeAlias

from gateway.model.text import Text, languages, text_of


@dataclass(frozen=True, slots=True)
class Amount:
    """A number with its unit."""

    n: float | None
    u: str = ""
    d: int = 1
    """Digits after the point."""
    sign: bool = False
    """Whether a plus is written."""


@dataclass(frozen=True, slots=True)
class ToldTime:
    """A time, ISO 8601 in UTC."""

    t: str


@dataclass(frozen=True, slots=True)
class ToldName:
    """A text of others, such as a channel's name; never interpreted."""

    s: str


@dataclass(frozen=True, slots=True)
class Word:
    """A key of the catalogue; a text that the catalogue does not know is shown as it is."""

    w: str


@dataclass(frozen=True, slots=True)
class InEach:
    """What a gateway says, by language."""

    x: Mapping[str, str]


Atom: TypeAlias = "Amount | ToldTime | ToldName | Word | InEach | Sentence"


@dataclass(frozen=True, slots=True)
class Sentence:
    """One sentence."""

    say: str
    """Key of the catalogue."""
    values: Mapping[str, Atom] = field(default_factory=dict)
    """What stands in its {braces}."""


@dataclass(frozen=True, slots=True)
class SaidRow:
    """A label and what is said under it."""

    label: str
    """Key of the catalogue."""
    said: Sentence
    mark: str = ""
    """`good`, `notice`, `bad`, or empty; a word stands beside the colour."""


def um(value: float, *, sign: bool = False) -> Amount:
    """Micrometres."""
    return Amount(round(value, 3) if math.isfinite(value) else None, "µm", sign=sign)


def tolerance(value_um: float) -> Amount:
    """A tolerance, without digits that nobody typed in."""
    return Amount(round(value_um, 1), "µm", d=int(value_um % 1 > 0))


def lasting(seconds: float) -> Amount:
    """A time that something takes: seconds up to 90, then minutes."""
    return Amount(round(seconds), "s", d=0) if seconds < 90.0 else Amount(round(seconds / 60.0, 1), "min", d=0)


def at(time: datetime) -> ToldTime:
    """A time."""
    return ToldTime(time.isoformat())


def name(text: str) -> Sentence:
    """A text of others by itself."""
    return Sentence("sentence.text", {"text": ToldName(text)})


def told(text: Text) -> Sentence:
    """What a gateway says, by itself."""
    return Sentence("sentence.text", {"text": in_each(text)})


UNHEARD: Final = Sentence("page.nothing_heard")
"""Why a gateway cannot be asked."""


def why(error: Exception) -> Atom:
    """What an error says, in each language that its sender knows."""
    return in_each(text_of(error))


def in_each(text: Text) -> Atom:
    """What a gateway says, within a sentence; words of others in no language but their own."""
    return InEach({code: text.in_language(code) for code in languages()}) if text.code else ToldName(text)
