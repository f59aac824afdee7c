"""The lines that say why each correction was what it was, and how sharply the sensors are watched."""

import pytest

from gateway.listeners.web import parts
from gateway.listeners.web.audit import correction_lines, corrections
from gateway.listeners.web.sentences import Amount, ToldName, Word
from gateway.telemetry.messages import PublishedReason
from tests.benches.heard import BEGAN, STEP, HeardMachine


def explained(steps: int = 1) -> HeardMachine:
    heard = HeardMachine()
    heard.measurement()
    for k in range(steps):
        heard.passes(STEP)
        heard.decision(k, corrected={"EZ0A": 33.0}, sigma={"EZ0A": 2.0})
        heard.reasons(k)
    return heard


def test_a_line_has_the_inputs_the_experts_the_interval_and_the_last_measurement() -> None:
    (line,) = corrections(explained().seen)
    assert (line.t, line.error, line.measured) == ((BEGAN + STEP).isoformat(), "EZ0A", BEGAN.isoformat())
    assert line.estimate == Amount(33.0, "µm", sign=True)
    assert line.half.n == pytest.approx(1.96 * 2.0)
    assert [(name, by.n) for name, by in line.movers] == [("spindle_rear", 30.0), ("bed", -2.0)]
    whole = sum(by.n or 0.0 for _, by in line.movers) + (line.rest.n or 0.0)
    assert whole == pytest.approx(line.estimate.n)
    assert [kind for kind, _ in line.experts] == [Word("expert.chosen_inputs"), Word("expert.all_inputs")]
    assert [share.n for _, share in line.experts] == pytest.approx([75.0, 22.0])


def test_what_is_shown_of_a_line_adds_up_to_a_tenth() -> None:
    """2.04 and 1.04 are shown as 2.0 and 1.0: what they lack of 5.1 is with the rest, beside what no input explains."""
    reason = PublishedReason(5.08, True, 1.0, {"bed": 2.04, "column": 1.04}, 0.0, 2.0, {}, 0.0, 1.0)
    (line,) = correction_lines(BEGAN.isoformat(), 1, {"EZ0A": reason}, {}, None)
    shown = [round(by.n or 0.0, 1) for _, by in line.movers]
    assert (shown, line.rest.n, line.level.n) == ([2.0, 1.0], 2.1, 2.0)


def test_the_newest_comes_first_and_the_oldest_go() -> None:
    times = [line.t for line in corrections(explained(60).seen)]
    assert len(times) == 40
    assert times == sorted(times, reverse=True)
    assert times[0] == (BEGAN + 60 * STEP).isoformat()


def test_what_is_not_corrected_has_no_line_and_a_repeated_answer_no_second_one() -> None:
    heard = explained()
    heard.reasons(0)
    assert [line.error for line in corrections(heard.seen)] == ["EZ0A"]
    heard.reasons(1, trusted=())
    assert len(list(corrections(heard.seen))) == 1


def test_reasons_of_another_step_than_the_decision_have_no_interval() -> None:
    heard = explained()
    heard.reasons(7)
    newest, _ = corrections(heard.seen)
    assert newest.half.n is None


def test_the_scatter_is_that_of_the_latest_measurement_beside_the_others() -> None:
    heard = HeardMachine()
    assert "label.scatter" not in [row.label for row in parts.health(heard.seen)]
    for number, residual in enumerate((0.3, 0.5, None, 2.0), start=1):
        heard.passes(STEP)
        heard.measurement(number, residual_um=residual)
    (row,) = [row for row in parts.health(heard.seen) if row.label == "label.scatter"]
    numbers = {name: value.n for name, value in row.said.values.items() if isinstance(value, Amount)}
    assert numbers == {"now": 2.0, "median": 0.5, "most": 2.0, "n": 3}


def test_it_says_how_small_an_abnormal_temperature_would_be_seen() -> None:
    heard = HeardMachine()
    assert parts.watched(heard.seen) is None
    heard.sensors({"bed": 0.5, "column": 0.7, "air": 3.0, "new": None})
    said = parts.watched(heard.seen)
    assert said is not None
    assert said.values["name"] == ToldName("air")
    numbers = {name: value.n for name, value in said.values.items() if isinstance(value, Amount)}
    assert numbers == {"n": 3, "median": 0.7, "worst": 3.0}


def test_it_says_which_loads_a_temperature_is_compared_with() -> None:
    heard = HeardMachine()
    heard.sensors({"bed": 0.5}, loads=("spindle_speed", "coolant"))
    said = parts.watched(heard.seen)
    assert said is not None
    assert (said.say, said.values["loads"]) == ("doubt.watched_with_loads", ToldName("spindle_speed, coolant"))
