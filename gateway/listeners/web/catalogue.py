"""The texts of the page in each language, from one file."""

import tomllib
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Final

LANGUAGES: Final[Mapping[str, str]] = {"en": "English", "de": "Deutsch"}
"""Code to its own name; the first is for browsers that ask for none of them."""


@cache
def texts(language: str) -> Mapping[str, str]:
    """Key to text. Raises KeyError for a language that is not in LANGUAGES."""
    found: dict[str, str] = {}
    _flatten(
        "",
        tomllib.loads(files("gateway.listeners.web").joinpath("texts.toml").read_text(encoding="utf-8")),
        language,
        found,
    )
    return found


def _flatten(prefix: str, table: Mapping[str, object], language: str, found: dict[str, str]) -> None:
    for key, value in table.items():
        name = f"{prefix}{key}"
        if not isinstance(value, dict):
            raise TypeError(f"texts.toml: {name} is not a table")
        if all(isinstance(text, str) for text in value.values()):
            found[name] = value[language]
        else:
            _flatten(f"{name}.", value, language, found)


def chosen_language(asked: str | None, accepted: str) -> str:
    """The language of a page.

    asked: in its address; accepted: the header Accept-Language
    """
    if asked in LANGUAGES:
        return str(asked)
    wanted = []
    for part in accepted.split(",")[:20]:
        code, _, weight = part.partition(";")
        try:
            q = float(weight.strip().removeprefix("q=") or 1.0)
        except ValueError:
            continue
        wanted.append((-q, code.strip().lower().partition("-")[0]))
    return next(
        (code for _, code in sorted(wanted, key=lambda each: each[0]) if code in LANGUAGES), next(iter(LANGUAGES))
    )
