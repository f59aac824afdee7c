"""When a machine will be ready and what would help: samples in, sentences out; the time is an argument."""

from collections.abc import Sequence
from datetime import datetime, timedelta

import numpy as np
import pytest

from gateway.listeners.web.at_tool import WorkPoint, half_width
from gateway.listeners.web.scenario import shown_scenario
from gateway.listeners.web.sentences import Amount, Atom, Sentence, ToldName, ToldTime, Word, at
from gateway.listeners.web.verdict import Viewpoint, verdict_of
from gateway.listeners.web.view import shown_course, view
from gateway.telemetry.answers import ScenarioPage
from gateway.telemetry.messages import PublishedCourse
from talc.names import THERMAL_ERRORS
from tests.benches.heard import BEGAN, STEP, HeardMachine

MATRIX = WorkPoint(150.0, 0.0, 80.0).matrix(0.15)
WITHIN = Viewpoint(MATRIX, 10.0)
HALF_UM = float(half_width(MATRIX, np.full(9, 0.1))[2])
"""Of Z, where each of the nine errors is uncertain by 0.1."""


def passes(*course: tuple[float, float], limit_um: float = 10.0) -> ToldTime:
    """When the straight line between two pairs of hours and of EZ0A reaches the limit with its interval."""
    (begin, first), (end, last) = course
    hours = begin + (end - begin) * (limit_um - HALF_UM - first) / (last - first)
    return at(BEGAN + timedelta(hours=hours))


def same(told: Atom, expected: ToldTime) -> bool:
    """To a millisecond."""
    assert isinstance(told, ToldTime)
    return abs(datetime.fromisoformat(told.t) - datetime.fromisoformat(expected.t)) < timedelta(milliseconds=1)


def cooling(after: Sequence[float], *, now: float = 30.0, missed: float | None = 0.0) -> HeardMachine:
    """A machine that is only monitored: EZ0A is `now`, and `after` in 30 min, 2 h and 8 h."""
    heard = HeardMachine()
    heard.compensation(mode="advise")
    heard.decision(corrected={"EZ0A": now})
    heard.forecast({"EZ0A": after}, missed=missed)
    return heard


def helps(heard: HeardMachine, viewpoint: Viewpoint = WITHIN) -> dict[str, Sentence]:
    return {said.say: said for said in verdict_of(heard.seen, viewpoint, heard.now_s).helps}


def amount(said: Sentence, name: str) -> float:
    found = said.values[name]
    assert isinstance(found, Amount)
    assert found.n is not None
    return found.n


def test_it_is_ready_when_the_whole_interval_comes_within_the_tolerance() -> None:
    said = helps(cooling((20.0, 8.0, 2.0)))["when.ready"]
    assert same(said.values["at"], passes((0.5, 20.0), (2.0, 8.0)))


def test_a_forecast_that_may_be_off_by_more_than_it_says_promises_nothing() -> None:
    """8 µm ± 5.9: it may be ready in two hours, and may not be in eight."""
    heard = cooling((20.0, 8.0, 2.0), missed=3.0)
    said = helps(heard)
    assert "when.ready" not in said
    assert said["when.not_before"].values["at"] == at(BEGAN + timedelta(minutes=30))
    said = helps(cooling((9.0, 8.0, 2.0), missed=3.0))
    assert "when.not_before" not in said
    assert "when.not_foreseeable" in said


@pytest.mark.parametrize("absurd", [1e200, -1e200])
def test_a_forecast_of_what_no_machine_can_have_promises_nothing(absurd: float) -> None:
    """Squared, such a number is beyond any double."""
    heard = cooling((absurd, 8.0, 2.0), missed=abs(absurd))
    heard.forecast({"EZ0A": (20.0, absurd, 2.0)}, sigma=absurd, measured=absurd)
    assert not {"when.ready", "help.best", "help.best_enough", "help.enough"} & helps(heard).keys()
    assert shown_course(heard.seen, WITHIN).ahead_t == []


def test_what_was_not_yet_compared_with_what_came_is_not_said() -> None:
    heard = cooling((20.0, 8.0, 2.0), missed=None)
    said = helps(heard)
    assert {"when.not_checked", "help.unforeseeable"} <= said.keys()
    assert not {"when.ready", "help.best", "help.best_enough", "help.nothing", "help.stop"} & said.keys()
    assert shown_course(heard.seen, WITHIN).ahead_t == []


def test_a_machine_that_does_not_come_within_the_tolerance_says_so() -> None:
    said = helps(cooling((30.0, 29.0, 28.0), missed=0.5))
    assert said["when.not_within"].values["at"] == at(BEGAN + timedelta(hours=8))


def test_a_ready_machine_says_until_when_it_stays_so() -> None:
    heard = cooling((3.0, 8.0, 20.0), now=2.0)
    assert same(helps(heard)["when.until"].values["at"], passes((2.0, 8.0), (8.0, 20.0)))
    leaving = helps(cooling((12.0, 8.0, 2.0), now=2.0))
    assert same(leaving["when.until"].values["at"], passes((0.0, 2.0), (0.5, 12.0)))
    assert leaving["when.until"].values["axis"] == Word("Z")
    assert helps(cooling((3.0, 8.0, 9.0), now=2.0))["when.stays"].values["at"] == at(BEGAN + timedelta(hours=8))
    assert "when.stays_unknown" in helps(cooling((12.0, 8.0, 2.0), now=2.0, missed=None))
    unforeseen = HeardMachine()
    unforeseen.compensation()
    unforeseen.decision()
    assert list(helps(unforeseen)) == ["when.stays_unknown"]


def test_what_helps_most_is_said_first_and_by_how_much() -> None:
    """Waiting takes 10 µm off; the usual heat takes 28 µm off."""
    heard = cooling((20.0, 18.0, 17.0), missed=0.1)
    heard.forecast({"EZ0A": (20.0, 18.0, 17.0)}, missed=0.1, usual={"EZ0A": (10.0, 2.0, 2.0)})
    said = verdict_of(heard.seen, WITHIN, heard.now_s).helps
    best, *others = (each for each in said if "what" in each.values)
    assert (best.say, best.values["what"]) == ("help.best_enough", Word("help.warm"))
    assert amount(best, "far") == pytest.approx(2.0 + HALF_UM, abs=0.01)
    by_option = {each.values["what"]: each for each in others}
    assert by_option[Word("help.wait")].say == "help.option"
    assert amount(by_option[Word("help.wait")], "gain") == pytest.approx(-10.0, abs=0.01)
    assert by_option[Word("help.probe")].say == "help.little", "an interval as narrow as before"
    assert by_option[Word("help.warm")].say == "help.enough"
    assert "help.stop" not in [each.say for each in said]


def test_a_corrected_machine_is_helped_by_a_measurement() -> None:
    """It follows the estimate: only the estimate's uncertainty is left, which a measurement narrows."""
    heard = HeardMachine()
    heard.compensation((0.0, 0.0, 30.0))
    heard.decision(corrected={"EZ0A": 30.0}, sigma=5.0)
    heard.forecast({"EZ0A": (60.0, 90.0, 90.0)}, sigma=5.0, measured=0.5, missed=0.2)
    said = helps(heard)
    assert said["help.best_enough"].values["what"] == Word("help.probe")
    assert said["help.enough"].values["what"] == Word("help.probe")
    assert "when.not_within" in said, "however the error itself moves"


def test_at_the_bound_of_the_compensation_nothing_is_promised() -> None:
    """How much the bound withholds at this point is not published: what is left is unknown, now and later."""
    heard = HeardMachine()
    heard.compensation((0.0, 0.0, 20.0), bounded=(False, False, True))
    heard.decision(corrected={"EZ0A": 30.0})
    heard.forecast({"EZ0A": (30.0, 30.0, 30.0)})
    assert not {"when.ready", "help.best", "help.best_enough", "help.enough"} & helps(heard).keys()


def test_warming_up_is_to_stop_when_more_of_it_brings_nothing() -> None:
    assert "help.stop" in helps(cooling((3.0, 3.0, 3.0), now=3.0, missed=0.5))
    assert "help.stop" not in helps(cooling((3.0, 1.0, 1.0), now=6.0, missed=0.5))


def test_warming_up_is_not_to_stop_while_the_usual_heat_or_the_next_two_hours_bring_something() -> None:
    settled = {"EZ0A": (3.0, 3.0, 3.0)}
    heard = cooling((3.0, 3.0, 3.0), now=3.0, missed=0.5)
    heard.forecast(settled, missed=0.5, usual={"EZ0A": (0.0, 0.0, 0.0)})
    assert "help.stop" not in helps(heard), "the usual heat takes 3 µm off"
    heard = cooling((6.0, 1.0, 1.0), now=6.0, missed=0.5)
    heard.forecast({"EZ0A": (6.0, 1.0, 1.0)}, missed=0.5, usual={"EZ0A": (6.0, 6.0, 6.0)})
    assert "help.stop" not in helps(heard), "after two hours 5 µm less, after half an hour nothing"


def test_what_may_be_off_is_not_said_to_be_enough_nor_never() -> None:
    """8 µm ± 5.9 in two hours is less than 30, and may be more than 10; 12 µm ± 5.9 may be within it."""
    options = [
        each
        for each in verdict_of(cooling((20.0, 8.0, 2.0), missed=3.0).seen, WITHIN, 0.0).helps
        if each.values.get("what") == Word("help.warm") and each.say != "help.best"
    ]
    assert [each.say for each in options] == ["help.option"]
    said = helps(cooling((20.0, 12.0, 12.0), missed=3.0))
    assert said["when.not_before"].values["at"] == at(BEGAN + timedelta(minutes=30))
    assert "when.not_within" not in said


def test_a_ready_machine_is_not_told_of_the_next_measurement() -> None:
    heard = cooling((2.0, 2.0, 2.0), now=2.0)
    heard.passes(STEP)
    heard.decision(1, corrected={"EZ0A": 2.0})  # two decisions tell how long a step is
    heard.reasons(1)
    assert "when.next_measurement" not in helps(heard)
    assert "when.next_measurement" in helps(heard, Viewpoint(MATRIX, 1.0))


def test_the_page_knows_the_planned_loads_of_which_it_may_speak() -> None:
    heard = cooling((2.0, 2.0, 2.0))
    assert view(heard.seen, WITHIN, heard.now_s).planned == ()
    heard.forecast({}, planned={"warm-up": None, "roughing": None})  # of a gateway whose status does not name them
    assert view(heard.seen, WITHIN, heard.now_s).planned == ("warm-up", "roughing")
    heard.status(planned_loads=("warm-up", "finishing"))
    assert view(heard.seen, WITHIN, heard.now_s).planned == ("warm-up", "finishing")


def test_the_page_knows_the_planned_loads_before_the_first_forecast() -> None:
    heard = HeardMachine()
    heard.status(planned_loads=("warm-up",))
    assert view(heard.seen, WITHIN, heard.now_s).planned == ("warm-up",)


@pytest.mark.parametrize("spoilt", ["another step", "too short", "no error", "absurd time"])
def test_a_forecast_that_does_not_fit_the_latest_estimate_is_none(spoilt: str) -> None:
    heard = cooling((20.0, 8.0, 2.0))
    match spoilt:
        case "another step":
            heard.passes(2 * STEP)
            heard.decision(2, corrected={"EZ0A": 30.0})
        case "too short":
            heard.forecast({"EZ0A": (20.0, 8.0)})
        case "no error":
            assert heard.seen.forecast is not None
            heard.seen.forecast.stays.pop("EZ0A")
        case _:
            heard.forecast({}, ahead_s=(1e300, 1e301, 1e302))
    assert "when.no_forecast" in helps(heard)


def test_the_chart_goes_on_with_the_forecast_and_its_band() -> None:
    heard = cooling((20.0, 8.0, 2.0), missed=2.0)
    course = shown_course(heard.seen, WITHIN)
    assert course.ahead_t == [(BEGAN + timedelta(hours=h)).timestamp() for h in (0.0, 0.5, 2.0, 8.0)]
    assert course.ahead[2] == course.ahead_left[2] == [30.0, 20.0, 8.0, 2.0], "advice takes back nothing"
    assert [colour for colour, _, _ in course.ahead_state] == ["red", "amber", "green"]
    assert shown_course(heard.seen, Viewpoint(MATRIX, None)).ahead_state == []
    assert course.ahead_left_half == course.ahead_half
    now, *later = course.ahead_half[2]
    assert now is not None
    assert now < 1.0
    assert all(half is not None and half > 1.96 * 2.0 for half in later)
    heard.seen.disappear(heard.now)
    assert shown_course(heard.seen, WITHIN).ahead_t == []


def test_the_band_of_what_is_left_reaches_as_far_as_the_verdict_ahead_where_the_control_follows() -> None:
    heard = HeardMachine()
    heard.compensation((0.0, 0.0, 30.0))
    heard.decision(corrected={"EZ0A": 30.0})
    heard.forecast({"EZ0A": (20.0, 8.0, 2.0)}, missed=2.0)
    course = shown_course(heard.seen, WITHIN)
    assert course.ahead_left[2] == [0.0] * 4
    green, amber = course.ahead_state
    assert (green[0], amber[0]) == ("green", "amber")
    now, *later = course.ahead_left_half[2]
    assert now == course.ahead_half[2][0]
    assert all(half is not None and half > 10.0 for half in later), "beyond the tolerance"
    assert all(half is not None and half < 10.0 for half in course.ahead_half[2])


def under(after: Sequence[float] | None, *, now: float = 30.0, missed: float | None = 0.0) -> Sentence:
    """What the page says about a planned load under which EZ0A is `after`; None: the effect is unknown."""
    heard = cooling((now, now, now), now=now, missed=missed)
    planned = {"face <b>milling": None if after is None else {"EZ0A": after}}
    heard.forecast({"EZ0A": (now, now, now)}, missed=missed, planned=planned)
    (said,) = [each for key, each in helps(heard).items() if key.startswith("planned.")]
    assert said.values["load"] == ToldName("face <b>milling")
    return said


def test_when_it_will_be_ready_under_a_planned_load() -> None:
    said = under((20.0, 8.0, 2.0))
    assert said.say == "planned.ready"
    assert same(said.values["at"], passes((0.5, 20.0), (2.0, 8.0)))
    said = under((20.0, 18.0, 12.0))
    assert (said.say, said.values["at"]) == ("planned.not_certain", at(BEGAN + timedelta(hours=8)))
    assert 12.0 < amount(said, "low") <= amount(said, "high") < 13.0
    assert under((20.0, 8.0, 2.0), missed=30.0).say == "planned.not_certain", "forecasts have been off by more"


def test_until_when_it_stays_ready_under_a_planned_load() -> None:
    said = under((3.0, 8.0, 12.0), now=2.0)
    assert said.say == "planned.until"
    assert same(said.values["at"], passes((2.0, 8.0), (8.0, 12.0)))
    assert under((3.0, 8.0, 9.0), now=2.0).say == "planned.stays"


def test_sentence_strip_and_curve_name_one_end_of_ready() -> None:
    heard = cooling((3.0, 8.0, 20.0), now=2.0)
    heard.forecast({"EZ0A": (3.0, 8.0, 20.0)}, planned={"warm-up": {"EZ0A": (3.0, 12.0, 20.0)}})
    told = helps(heard)["when.until"].values["at"]
    assert isinstance(told, ToldTime)
    end = datetime.fromisoformat(told.t).timestamp()
    (colour, begin, turns), *_ = shown_course(heard.seen, WITHIN).ahead_state
    assert (colour, begin, turns) == ("green", BEGAN.timestamp(), end)
    as_now, warm_up = view(heard.seen, WITHIN, heard.now_s).branches
    assert as_now.turn is not None
    assert as_now.began + as_now.turn == pytest.approx(end, abs=1e-3)
    assert warm_up.turn is not None
    assert np.interp(warm_up.turn, warm_up.t, np.array(warm_up.high, dtype=np.float64)) == pytest.approx(10.0, abs=0.01)


def test_a_time_for_which_no_forecast_was_checked_has_no_colour() -> None:
    course = shown_course(cooling((3.0, 8.0, 20.0), now=2.0, missed=None).seen, WITHIN)
    assert course.ahead_state == []


def test_what_a_planned_load_does_may_be_unknown() -> None:
    assert under(None).say == "planned.unknown"
    assert under((20.0, 8.0), missed=None).say == "planned.unknown", "of two times for three"
    assert under((20.0, 8.0, 2.0), missed=None).say == "planned.not_checked"


def scenario(stays: Sequence[float], loaded: Sequence[float] | None, loads: dict[str, float]) -> ScenarioPage:
    """EZ0A after 5 min, 20 min and 2 h."""

    def courses(values: Sequence[float]) -> dict[str, PublishedCourse]:
        return {e: PublishedCourse(list(values if e == "EZ0A" else [0.0] * 3), [0.1] * 3) for e in THERMAL_ERRORS}

    run = {} if loaded is None else courses(loaded)
    return ScenarioPage(BEGAN.isoformat(), 0, (300.0, 1200.0, 7200.0), 20.0, loads, courses(stays), run)


@pytest.mark.parametrize(
    ("loaded", "missed", "said"),
    [
        ((25.0, 8.0, 2.0), 0.0, "scenario.ready"),
        ((25.0, 8.0, 2.0), None, "scenario.not_checked"),
        ((29.0, 25.0, 20.0), 0.5, "scenario.better"),
        ((31.0, 35.0, 40.0), 0.5, "scenario.worse"),
        (None, 0.0, "scenario.unknown"),
    ],
)
def test_what_a_load_of_some_minutes_would_do_is_said_as_far_as_forecasts_have_been_checked(
    loaded: Sequence[float] | None, missed: float | None, said: str
) -> None:
    heard = cooling((30.0, 30.0, 30.0), missed=missed)
    found = shown_scenario(heard.seen, scenario((30.0,) * 3, loaded, {"spindle_speed": 6000.0}), WITHIN, heard.now_s)
    assert [sentence.say for sentence in found.said] == [said]
    as_now, *run = found.branches
    assert (as_now.t[0], as_now.t[-1]) == (0.0, 7200.0)
    assert (as_now.high[1] is None) == (missed is None)
    if said == "scenario.ready":
        assert found.said[0].values["load"] == Word("scenario.spindle"), "no name of a channel"
        assert found.said[0].values["instead"] == ToldName(""), "as it is now, it does not become so"
        assert same(found.said[0].values["at"], passes((1 / 12, 25.0), (1 / 3, 8.0)))
        assert run[0].turn is not None
        assert at(BEGAN + timedelta(seconds=run[0].turn)) == found.said[0].values["at"]
        assert run[0].high[-1] == pytest.approx(2.2, abs=0.2)
    (none,) = shown_scenario(heard.seen, scenario((30.0,) * 3, None, {}), WITHIN, heard.now_s).said
    assert none.say == "scenario.no_load"


def test_what_a_load_would_do_is_told_beside_the_end_that_the_page_tells() -> None:
    heard = cooling((3.0, 8.0, 20.0), now=2.0)
    page = scenario((3.0, 3.0, 8.0), (3.0, 12.0, 20.0), {"spindle_speed": 6000.0})
    (said,) = shown_scenario(heard.seen, page, WITHIN, heard.now_s, "warm-up").said
    assert (said.say, said.values["load"]) == ("scenario.leaves", ToldName("warm-up"))
    assert said.values["instead"] == Sentence("scenario.instead", {"at": helps(heard)["when.until"].values["at"]})
