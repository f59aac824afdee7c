"""Queries on `report`: the report of one day."""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import date

from gateway.model.text import languages
from gateway.telemetry.answers import ReportPage
from gateway.telemetry.codec import encode
from gateway.telemetry.queries import Answering, Replied, parameters_of

_LONGEST_NAME = 64
LARGEST_TOLERANCE_UM = 1e4


@dataclass(frozen=True, slots=True)
class ReportRequest:
    """What a query on `report` asks for."""

    day: date
    zone: str
    """Time zone of the day, such as Europe/Zurich; empty: the time zone of the gateway's computer."""
    language: str = "en"
    """Of the catalogue."""
    tolerance_um: float | None = None
    """Of the jobs; None: what part programs stated last."""


ReportSource = Callable[[ReportRequest], ReportPage]
"""Makes the page. Raises ValueError when the request is wrong, OSError when it cannot be made."""


def report_answer(source: ReportSource) -> Answering:
    """What answers queries with reports of this source."""
    return lambda asked: Replied(encode(source(parse_report(asked.parameters))))


def parse_report(selected: str) -> ReportRequest:
    """The request of a selector's parameters.

    Raises ValueError naming parameter, value and what would be right.
    """
    parameters = parameters_of(selected, ("day", "zone", "language", "tolerance"))
    day, zone = parameters.get("day", ""), parameters.get("zone", "")
    try:
        found = date.fromisoformat(day)
    except ValueError:
        raise ValueError(f"day = {day!r}: expected a day such as 2026-03-02") from None
    if not 2000 <= found.year < 2200:
        raise ValueError(f"day = {day!r}: expected one between 2000 and 2199")
    if len(zone) > _LONGEST_NAME:
        raise ValueError(f"zone: expected at most {_LONGEST_NAME} letters, such as Europe/Zurich")
    language = parameters.get("language", "en")
    if language not in languages():
        raise ValueError(f"language = {language!r}: expected one of {', '.join(languages())}")
    return ReportRequest(found, zone, language, _tolerance_um(parameters.get("tolerance")))


def _tolerance_um(text: str | None) -> float | None:
    if text is None:
        return None
    try:
        found = float(text)
    except ValueError:
        found = 0.0
    if not 0.0 < found <= LARGEST_TOLERANCE_UM:
        raise ValueError(f"tolerance = {text[:40]!r}: expected µm, at most {LARGEST_TOLERANCE_UM:g}")
    return found
