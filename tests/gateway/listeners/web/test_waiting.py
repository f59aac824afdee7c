"""What waiting for the next measurement costs: messages in, one row out."""

from datetime import timedelta

import pytest

from gateway.listeners.web.at_tool import WorkPoint
from gateway.listeners.web.sentences import Amount, SaidRow, Word, at
from gateway.listeners.web.waiting import cost_of_waiting
from tests.benches.heard import BEGAN, STEP, HeardMachine

MATRIX = WorkPoint(150.0, 0.0, 80.0).matrix(0.15)


def growing(after: float, measured: float) -> HeardMachine:
    """A sigma of 1 now, which a forecast multiplies by `after`, or by `measured` if the machine is measured now."""
    heard = HeardMachine()
    heard.compensation()
    heard.decision(sigma=dict.fromkeys(("EY0A", "EZ0A", "EX0C", "EY0C", "EZ0T", "ER0T", "EA0C", "EB0C", "EC0C"), 1.0))
    heard.forecast({}, sigma=after, measured=measured)
    return heard


def cost(heard: HeardMachine) -> list[SaidRow]:
    return list(cost_of_waiting(heard.seen, MATRIX, heard.now_s))


def numbers(row: SaidRow) -> dict[str, float | None]:
    return {name: value.n for name, value in row.said.values.items() if isinstance(value, Amount)}


def test_the_interval_if_it_is_not_measured_stands_beside_that_after_a_measurement_now() -> None:
    """Half of the interval is proportional to sigma, as all nine have the same; numbers are rounded to nanometres."""
    (row,) = cost(growing(after=5.0, measured=0.5))
    told = numbers(row)
    now = told["now"]
    assert now is not None
    assert now > 1.96
    assert (told["then"], told["measured"]) == pytest.approx((5.0 * now, 0.5 * now), abs=0.005)
    assert row.said.values["at"] == at(BEGAN + timedelta(hours=2)), "no measurement is expected"
    assert row.said.values["axis"] == Word("Y"), "two tilts and two positions move it there; X and Z have one tilt"


def test_it_is_stated_for_when_the_next_measurement_is_expected() -> None:
    heard = growing(after=2.0, measured=1.0)
    heard.passes(STEP)
    heard.decision(1)
    heard.forecast({}, sigma=2.0, measured=1.0, k=1)
    heard.reasons(k=1)  # the next one comes an hour later; half an hour is nearer than two
    (row,) = cost(heard)
    assert row.said.values["at"] == at(BEGAN + STEP + timedelta(minutes=30))


def test_without_a_current_estimate_or_a_forecast_nothing_is_said() -> None:
    heard = growing(after=2.0, measured=1.0)
    heard.seen.disappear(heard.now)
    assert cost(heard) == []
    heard = growing(after=2.0, measured=1.0)
    heard.passes(timedelta(minutes=16))
    assert cost(heard) == []
    heard = HeardMachine()
    heard.decision()
    assert cost(heard) == []
    heard = growing(after=2.0, measured=1.0)
    assert heard.seen.forecast is not None
    for error in list(heard.seen.forecast.measured):
        heard.seen.forecast.measured[error] = [None] * 3
    assert cost(heard) == []
