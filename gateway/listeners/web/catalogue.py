"""The texts of the page, of all that the catalogue has, and the language of a browser."""

from collections.abc import Mapping
from functools import cache

from gateway.model.text import languages, texts

_ELSEWHERE = (
    "text.",
    "language.",
    "fault.",
    "file_word.",
    "input_fault.",
    "measurement_fault.",
    "matters.",
    "remedy.",
    "moment.",
    "slowed.",
    "armed_mode.",
    "doctor.",
    "status.",
    "watch.",
    "report.",
    "report_",
    "replay.",
    "replay_",
    "demo.",
    "dry_run.",
    "dry_run_",
    "naming.",
    "nothing.",
    "of_profile.",
    "poses.",
    "system_error.",
)
"""Groups that the server writes out itself, or other programs."""


@cache
def page_texts(language: str) -> Mapping[str, str]:
    """Key to text. Raises OSError for a language that there is not."""
    return {key: text for key, text in texts(language).items() if not key.startswith(_ELSEWHERE)}


def chosen_language(asked: str | None, accepted: str) -> str:
    """The language of a page.

    asked: in its address; accepted: the header Accept-Language
    """
    known = languages()
    if asked in known:
        return str(asked)
    wanted = []
    for part in accepted.split(",")[:20]:
        code, _, weight = part.partition(";")
        try:
            q = float(weight.strip().removeprefix("q=") or 1.0)
        except ValueError:
            continue
        wanted.append((-q, code.strip().lower().partition("-")[0]))
    return next((code for _, code in sorted(wanted, key=lambda each: each[0]) if code in known), next(iter(known)))
