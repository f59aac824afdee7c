"""Queries on `scenario`: a forecast under a load that runs for some minutes."""

from collections.abc import Callable
from dataclasses import dataclass

from gateway.telemetry.answers import ScenarioPage
from gateway.telemetry.codec import encode
from gateway.telemetry.queries import Answering, Replied, parameters_of

USUAL_MIN = "20"
_LONGEST_MIN = 120
_MOST_DIGITS = 3


@dataclass(frozen=True, slots=True)
class ScenarioRequest:
    """What a query on `scenario` asks for."""

    load: str
    """Name of a planned load of the configuration; empty: the spindle as it usually runs."""
    minutes: int


ScenarioSource = Callable[[ScenarioRequest], ScenarioPage]
"""Computes it. Raises ValueError when the request is wrong, OSError when there is no forecast."""


def scenario_answer(source: ScenarioSource) -> Answering:
    """What answers queries with forecasts of this source."""
    return lambda asked: Replied(encode(source(parse_scenario(asked.parameters))))


def parse_scenario(selected: str) -> ScenarioRequest:
    """The request of a selector's parameters. Raises ValueError naming parameter, value and what would be right."""
    parameters = parameters_of(selected, ("load", "minutes"))
    return ScenarioRequest(parameters.get("load", ""), minutes_of(parameters.get("minutes", USUAL_MIN)))


def minutes_of(text: str) -> int:
    """How long a load runs. Raises ValueError."""
    digits = text.isascii() and text.isdecimal() and len(text) <= _MOST_DIGITS
    if not (digits and 1 <= int(text) <= _LONGEST_MIN):
        raise ValueError(f"minutes = {text!r}: expected 1 to {_LONGEST_MIN}")
    return int(text)
