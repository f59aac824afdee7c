"""The gateway's own texts, which it publishes in English, as sentences of the catalogue: in the browser's language."""

import re
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Final

from drivers.base import Quality
from gateway.listeners.web.catalogue import texts
from gateway.listeners.web.sentences import Amount, Atom, Sentence, ToldName, Word, name
from gateway.model.commands import CommandName
from gateway.model.standing import Standing
from talc.frame import Phase, Why
from talc.names import THERMAL_ERRORS

_LONGEST = 1000
"""A longer text is not one of the gateway's sentences, and is not compared with them."""
_DEEPEST = 3
_NUMBER = r"-?[0-9]+\.[0-9]"


def _any(words: object) -> str:
    return "|".join(re.escape(str(word)) for word in words)  # type: ignore[attr-defined]


_FORMS: Final[Mapping[str, str]] = {
    "n": "[0-9]+",
    "number": _NUMBER,
    "limit": _NUMBER,
    "unit": "µm|µm/m",
    "error": _any(THERMAL_ERRORS),
    "phase": _any(phase.value for phase in Phase),
    "next": _any(phase.value for phase in Phase),
    "why": _any(why.value for why in Why),
    "standing": _any(standing.value for standing in Standing),
    "quality": _any(quality.value for quality in Quality),
    "command": _any(command.value for command in CommandName),
    "channel": "[^:]+",
    "subject": "(?:bus|device) [^:]+",
    "numbers": "[0-9, ]+",
}
"""What may stand in a place; elsewhere anything may."""
_GROUPS = {"phase": "phase", "next": "phase", "why": "why", "standing": "standing", "quality": "quality"}
"""Places in which a word of the catalogue stands, and its group."""


@cache
def _patterns() -> tuple[tuple[str, re.Pattern[str]], ...]:
    return tuple((key, _pattern(text)) for key, text in texts("en").items() if key.startswith("said."))


def _pattern(text: str) -> re.Pattern[str]:
    parts = re.split(r"\{(\w+)\}", text)
    made = (f"(?P<{p}>{_FORMS.get(p, '.+')})" if i % 2 else re.escape(p) for i, p in enumerate(parts))
    return re.compile("".join(made), re.DOTALL)


def told(text: str, depth: int = 0) -> Sentence:
    """The sentence that says this; one that the catalogue does not know says it as it is."""
    if len(text) <= _LONGEST and depth < _DEEPEST:
        for key, pattern in _patterns():
            if (found := pattern.fullmatch(text)) is not None:
                return Sentence(key, dict(_values(found, depth)))
    return name(text)


def _values(found: re.Match[str], depth: int) -> Iterator[tuple[str, Atom]]:
    for place, text in found.groupdict().items():
        if place in _GROUPS:
            yield place, Word(f"{_GROUPS[place]}.{text}")
        elif place in ("number", "limit"):
            yield place, Amount(float(text))
        elif place == "reason":
            yield place, told(text, depth + 1)
        else:
            yield place, ToldName(text)
