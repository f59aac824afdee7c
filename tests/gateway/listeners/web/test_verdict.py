"""Ready or not: samples in, a verdict out; the time is an argument."""

from datetime import timedelta

import numpy as np
import pytest

from gateway.listeners.web.at_tool import WorkPoint, at_the_tool, half_width, moved
from gateway.listeners.web.sentences import Amount, SaidRow, Sentence, ToldName, Word, at, in_each, told
from gateway.listeners.web.verdict import Colour, Viewpoint, verdict_of
from gateway.listeners.web.view import listed, shown_course, view
from gateway.model.codes import NoticeCode
from gateway.model.compensation import Source
from gateway.model.text import Text
from gateway.telemetry.fields import Coded, coded
from gateway.telemetry.messages import PauseStanding
from gateway.telemetry.subscriber.machine import Applied, applied
from gateway.telemetry.subscriber.site import SiteSeen
from talc.names import THERMAL_ERRORS
from tests.benches.heard import STEP, HeardMachine

MATRIX = WorkPoint(150.0, 0.0, 80.0).matrix(0.15)
Z_ONLY = {"EZ0A": 30.0}


def within(tolerance_um: float | None) -> Viewpoint:
    return Viewpoint(MATRIX, tolerance_um)


def test_the_deviation_at_a_point_is_that_of_the_kinematics() -> None:
    """The table has grown by 10 µm at 150 mm and the A axis sunk by 30 µm: 13.3 µm in X at 200 mm."""
    errors = np.array([0, -30, 0, 0, 0, 10, 0, 0, 0], dtype=np.float64)
    assert moved(WorkPoint(200.0, 0.0, 50.0).matrix(0.15), errors) == pytest.approx([40 / 3, 0, -30])


def test_the_interval_at_the_tool_is_the_root_of_the_squares() -> None:
    """EY0A and EY0C move Y one to one: 3 and 4 µm give 5 µm, and 1.96 times that to each side."""
    sigma = np.array([3, 0, 0, 4, 0, 0, 0, 0, 0], dtype=np.float64)
    assert half_width(MATRIX, sigma) == pytest.approx([0, 1.96 * 5, 0])


@pytest.mark.parametrize(
    ("left", "missed", "colours"),
    [(0.0, 20.0, "green amber"), (0.0, 1.0, "green"), (30.0, 7.0, "green amber red"), (30.0, 9.0, "green amber")],
)
def test_an_interval_that_grows_around_nothing_is_not_foreseen_as_outside(
    left: float, missed: float, colours: str
) -> None:
    """30 µm are surely more than 8 if the forecast of Z may be off by 20 µm (95 %), and not if by 25."""
    heard = HeardMachine()
    heard.compensation(mode="advise")
    heard.decision(corrected={"EZ0A": 0.0})
    heard.forecast({"EZ0A": (left, left, left)}, missed=missed)
    course = shown_course(heard.seen, within(8.0))
    assert " ".join(colour for colour, _, _ in course.ahead_state) == colours


def test_what_is_beyond_the_tolerance_is_never_written_as_within_it() -> None:
    """3 µm left and 1.96 times 2.571: 8.04 µm, which is more than 8."""
    heard = HeardMachine()
    heard.compensation((0.0, 0.0, 27.0), (0.0, 0.0, 30.0))
    heard.decision(corrected=Z_ONLY, sigma={"EZ0A": 2.571} | dict.fromkeys(("EA0C", "EZ0T", "ER0T"), 0.0))
    shown = view(heard.seen, within(8.0), heard.now_s)
    z = shown.axes[2]
    assert (shown.verdict.colour, z.colour, z.left.n) == ("amber", "amber", 3.0)
    assert z.far.n == pytest.approx(8.1)
    assert z.half.n == pytest.approx(5.1)
    assert shown.verdict.because[0].values["far"] == z.far


def test_an_error_that_does_not_move_the_tool_here_may_be_unknown() -> None:
    """In the middle of the table its radial growth moves nothing."""
    centre = WorkPoint(0.0, 0.0, 80.0).matrix(0.15)
    errors = np.zeros(9)
    errors[5] = np.nan
    nothing = Applied(False, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (False, False, False))
    assert np.isfinite(at_the_tool(centre, errors, np.abs(errors), nothing).far).all()
    assert np.isnan(moved(MATRIX, errors)[0])


@pytest.mark.parametrize(
    ("tolerance", "colour", "word"),
    [(6.0, Colour.GREEN, "word.ready"), (3.0, Colour.AMBER, "word.unsure"), (1.0, Colour.RED, "word.not_ready")],
)
def test_the_interval_against_the_tolerance_gives_the_colour(tolerance: float, colour: Colour, word: str) -> None:
    """3 µm are left in Z, ± 1.96: at least 1.04, at most 4.96."""
    heard = HeardMachine()
    heard.compensation((0.0, 0.0, 27.0), (0.0, 0.0, 30.0))
    heard.decision(corrected=Z_ONLY, sigma={"EZ0A": 1.0} | dict.fromkeys(("EA0C", "EZ0T", "ER0T"), 0.0))
    verdict = verdict_of(heard.seen, within(tolerance), heard.now_s)
    assert (verdict.colour, verdict.word) == (colour, word)
    if colour is not Colour.GREEN:
        order = verdict.because[0].values
        assert order["axis"] == Word("Z")
        assert (order["tolerance"], order["met"]) == (Amount(tolerance, "µm", d=0), Amount(5, "µm", d=0))


@pytest.mark.parametrize(
    ("sigma", "tolerance", "colour"),
    [(0.0, 3.0, Colour.GREEN), (1.0, 3.0 + 1.96, Colour.GREEN), (1.0, 3.0 - 1.96, Colour.AMBER)],
)
def test_an_end_of_the_interval_that_equals_the_tolerance_is_within_it(
    sigma: float, tolerance: float, colour: Colour
) -> None:
    heard = HeardMachine()
    heard.compensation((0.0, 0.0, 27.0), (0.0, 0.0, 30.0))
    heard.decision(corrected=Z_ONLY, sigma=dict.fromkeys(THERMAL_ERRORS, 0.0) | {"EZ0A": sigma})
    assert verdict_of(heard.seen, within(tolerance), heard.now_s).colour is colour


def test_without_a_tolerance_the_interval_is_said_and_no_colour_given() -> None:
    heard = HeardMachine()
    heard.decision()
    verdict = verdict_of(heard.seen, within(None), heard.now_s)
    assert (verdict.colour, verdict.word) == (Colour.GREY, "word.no_tolerance")
    assert [said.say for said in verdict.because] == ["because.left", "because.no_tolerance"]


def test_what_is_not_written_to_the_control_is_left() -> None:
    heard = HeardMachine()
    heard.compensation((0.0, 0.0, 30.0), mode="advise", written=False)
    heard.decision(corrected=Z_ONLY)
    assert verdict_of(heard.seen, within(20.0), heard.now_s).colour is Colour.RED
    shown = view(heard.seen, within(20.0), heard.now_s)
    assert shown.axes[2].left.n == pytest.approx(30.0)
    assert shown.axes[2].in_force.n == 0.0
    assert [said.say for said in shown.tool_notes] == ["tool.not_written"]


def test_a_gateway_that_is_gone_is_gone_at_once_and_says_when_it_was_heard() -> None:
    heard = HeardMachine()
    heard.compensation()
    heard.decision()
    assert verdict_of(heard.seen, within(10.0), heard.now_s).colour is Colour.GREEN
    heard.passes(timedelta(seconds=3))
    heard.seen.disappear(heard.now)
    verdict = verdict_of(heard.seen, within(10.0), heard.now_s)
    assert (verdict.colour, verdict.word, verdict.because[0].say) == (Colour.AWAY, "word.gone", "because.gone")
    assert (verdict.because[0].values, verdict.since) == ({"at": at(heard.now)}, heard.now)
    assert view(heard.seen, within(10.0), heard.now_s).axes == ()


@pytest.mark.parametrize(("when_stale", "said"), [("zero", "do.taken_back"), ("hold", "do.held"), (None, "do.away")])
def test_a_gateway_that_is_gone_has_told_what_becomes_of_the_offsets(when_stale: str | None, said: str) -> None:
    heard = HeardMachine()
    heard.status(when_stale=when_stale)
    heard.seen.disappear(heard.now)
    assert verdict_of(heard.seen, within(10.0), heard.now_s).because[-1].say == said


def test_a_machine_that_was_never_heard_says_what_to_do() -> None:
    verdict = verdict_of(HeardMachine(alive=False).seen, within(10.0), 0.0)
    assert (verdict.word, [said.say for said in verdict.because]) == ("word.never", ["because.never", "do.start"])


def test_a_gateway_without_a_grid_step_has_no_data() -> None:
    heard = HeardMachine()
    heard.reading("bed")
    assert verdict_of(heard.seen, within(10.0), heard.now_s).word == "word.no_data"


def test_an_estimate_grows_old_although_the_gateway_is_alive() -> None:
    heard = HeardMachine()
    heard.compensation()
    heard.decision()
    heard.passes(timedelta(minutes=14))
    assert verdict_of(heard.seen, within(10.0), heard.now_s).colour is Colour.GREEN
    heard.passes(timedelta(minutes=2))
    heard.reading("bed")
    assert verdict_of(heard.seen, within(10.0), heard.now_s).word == "word.old"
    assert view(heard.seen, within(10.0), heard.now_s).axes == ()


def test_on_a_coarse_grid_an_estimate_counts_for_three_steps() -> None:
    heard = HeardMachine()
    heard.compensation()
    heard.decision()
    heard.passes(timedelta(minutes=10))
    heard.decision(k=1)
    heard.passes(timedelta(minutes=29))
    assert verdict_of(heard.seen, within(10.0), heard.now_s).colour is Colour.GREEN
    heard.passes(timedelta(minutes=2))
    assert verdict_of(heard.seen, within(10.0), heard.now_s).word == "word.old"


def test_while_the_control_probes_it_is_not_ready() -> None:
    heard = HeardMachine()
    heard.compensation()
    heard.decision()
    heard.probing("asked")
    began = heard.seen.latest
    asked = verdict_of(heard.seen, within(10.0), heard.now_s)
    assert (asked.colour, asked.because[-1].say) == (Colour.GREEN, "because.asked"), "it has not begun"
    heard.passes(timedelta(minutes=2))
    heard.status(nc="probing")
    verdict = verdict_of(heard.seen, within(10.0), heard.now_s)
    assert (verdict.word, verdict.since) == ("word.probing", began)
    heard.probing("not_wanted", None)
    heard.status(nc="ready")
    ready = verdict_of(heard.seen, within(10.0), heard.now_s)
    assert (ready.colour, [said.say for said in ready.because]) == (Colour.GREEN, ["because.left"])


def test_while_it_measures_it_is_said_until_when_by_how_long_the_last_ones_took() -> None:
    heard = HeardMachine()
    heard.compensation()
    heard.measurement(sigma=0.1)
    heard.decision()
    heard.probing("asked")
    heard.status(nc="probing")
    took = heard.seen.measurements[-1].lasted_s
    assert took is not None
    ends = Sentence("when.measured", {"at": at(heard.now + timedelta(seconds=took))})
    assert verdict_of(heard.seen, within(10.0), heard.now_s).helps == (ends,)
    assert "label.next" not in {row.label for row in view(heard.seen, within(10.0), heard.now_s).waits}


def test_inputs_that_the_estimate_goes_without_are_said_beside_it_and_since_when() -> None:
    heard = HeardMachine()
    heard.compensation()
    for name in ("spindle_front", "spindle_rear"):
        heard.event("input_substituted", name, code="value_estimated", input=name)
        heard.passes(timedelta(minutes=1))
    first = heard.now - timedelta(minutes=2)
    heard.decision(substituted=("spindle_front", "spindle_rear"))
    verdict = verdict_of(heard.seen, within(10.0), heard.now_s)
    assert (verdict.colour, verdict.because[-1].say) == (Colour.GREEN, "because.without")
    values = verdict.because[-1].values
    assert values["since"] == Sentence("because.since", {"at": at(first)})
    assert values["more"] == Sentence("because.and_more", {"n": Amount(1, d=0)})


def test_the_phase_no_good_is_red_whatever_the_interval() -> None:
    heard = HeardMachine()
    heard.compensation()
    heard.decision(phase="no_good")
    assert verdict_of(heard.seen, within(1000.0), heard.now_s).colour is Colour.RED


@pytest.mark.parametrize(("measured", "said"), [(False, "because.no_measurement"), (True, "because.no_estimate")])
def test_an_error_without_an_estimate_leaves_the_interval_unknown(measured: bool, said: str) -> None:
    heard = HeardMachine()
    if measured:
        heard.measurement()
    heard.decision(corrected={"EZ0A": None})
    verdict = verdict_of(heard.seen, within(10.0), heard.now_s)
    assert (verdict.colour, verdict.because[0].say) == (Colour.GREY, said)


def test_a_correction_at_its_bound_or_not_taken_leaves_the_rest_unknown() -> None:
    heard = HeardMachine()
    heard.compensation((0.0, 0.0, 50.0), bounded=(False, False, True))
    heard.decision(corrected={"EZ0A": 70.0})
    assert verdict_of(heard.seen, within(10.0), heard.now_s).because[0].say == "because.bounded"
    heard.compensation((0.0, 0.0, 50.0), written=False)
    assert verdict_of(heard.seen, within(10.0), heard.now_s).because[0].say == "because.not_taken"


@pytest.mark.parametrize("source", list(Source))
def test_only_a_step_by_the_prediction_follows_the_estimate(source: Source) -> None:
    heard = HeardMachine()
    heard.compensation((1.0, 2.0, 3.0), source=source.value, written=source is not Source.FROZEN)
    now = applied(heard.seen.compensation)
    assert now.following == (source is Source.PREDICTION)
    assert now.offsets_um == (1.0, 2.0, 3.0)


@pytest.mark.parametrize("absurd", [1e200, -1e200, 1e6 + 1.0])
def test_what_no_machine_can_have_counts_as_unknown(absurd: float) -> None:
    """Squared, such a number is beyond any double."""
    heard = HeardMachine()
    heard.compensation((absurd, 0.0, 0.0), (-absurd, 0.0, 0.0))
    heard.decision(corrected={"EZ0A": absurd}, sigma={"EY0A": absurd})
    heard.measurement(sigma=absurd)
    verdict = verdict_of(heard.seen, within(10.0), heard.now_s)
    assert (verdict.colour, verdict.word) == (Colour.GREY, "word.unknown")
    shown = view(heard.seen, within(10.0), heard.now_s)
    assert [axis.left.n for axis in shown.axes] == [None, 0.0, None]
    assert shown_course(heard.seen, within(8.0)).without[2] == [None]


def test_it_says_since_when() -> None:
    heard, times = HeardMachine(), []
    heard.compensation()
    for k, sigma in enumerate((0.1, 0.1, 9.0, 9.0, 9.0)):
        times.append(heard.now)
        heard.decision(k, sigma=sigma)
        heard.passes(STEP)
    verdict = verdict_of(heard.seen, within(8.0), heard.now_s)
    assert (verdict.colour, verdict.since, verdict.before) == (Colour.AMBER, times[2], False)
    verdict = verdict_of(heard.seen, within(100.0), heard.now_s)
    assert (verdict.colour, verdict.since, verdict.before) == (Colour.GREEN, times[0], True)
    heard.decision(5, corrected={"EZ0A": None})
    verdict = verdict_of(heard.seen, within(8.0), heard.now_s)
    assert (verdict.word, verdict.since) == ("word.unknown", heard.now)


def test_a_phase_that_makes_it_red_is_red_since_it_began() -> None:
    heard, times = HeardMachine(), []
    heard.compensation()
    for k, phase in enumerate(("compensation", "compensation", "no_good", "no_good")):
        times.append(heard.now)
        heard.decision(k, phase=phase)
        heard.passes(STEP)
    verdict = verdict_of(heard.seen, within(8.0), heard.now_s)
    assert (verdict.word, verdict.since, verdict.before) == ("word.not_ready", times[2], False)


def test_a_time_of_which_nothing_is_known_ends_what_was_before() -> None:
    heard, times = HeardMachine(), []
    heard.compensation()
    for k in (0, 1, 40, 41):
        heard.passes(STEP * (38 if k == 40 else 1))
        times.append(heard.now)
        heard.decision(k)
    verdict = verdict_of(heard.seen, within(8.0), heard.now_s)
    assert (verdict.colour, verdict.since, verdict.before) == (Colour.GREEN, times[2], False)


@pytest.mark.parametrize("away", ["gone", "silent", "restarted"])
def test_a_time_in_which_the_gateway_was_away_ends_what_was_before(away: str) -> None:
    heard = HeardMachine()
    for k in (0, 1):
        heard.compensation()
        heard.decision(k)
        heard.passes(STEP)
    heard.passes(timedelta(minutes=2))
    match away:
        case "gone":
            heard.seen.disappear(heard.now)
            heard.seen.appear(heard.now)
        case "silent":
            heard.seen.listen(heard.now_s)
            assert verdict_of(heard.seen, within(8.0), heard.now_s).word == "word.silent"
        case _:
            heard.boot = "boot-2"
    heard.passes(timedelta(seconds=10))
    back = heard.now
    heard.compensation()
    if away == "restarted":
        heard.passes(timedelta(minutes=1))
        back = heard.now  # until then there was no data
    heard.decision(2)
    heard.seen.listen(heard.now_s)
    heard.passes(timedelta(seconds=20))
    verdict = verdict_of(heard.seen, within(8.0), heard.now_s)
    assert (verdict.word, verdict.since, verdict.before) == ("word.ready", back, False)


def test_a_measurement_that_was_expected_earlier_is_overdue() -> None:
    heard = HeardMachine()
    heard.decision(0)
    heard.passes(STEP)
    heard.decision(1)
    heard.reasons(1)
    expected = at(heard.now + 12 * STEP)
    rows = {row.label: row.said for row in view(heard.seen, within(8.0), heard.now_s).waits}
    assert (rows["label.next"].say, rows["label.next"].values["at"]) == ("next.expected", expected)
    heard.passes(12 * STEP + timedelta(minutes=8))
    heard.status()
    rows = {row.label: row.said for row in view(heard.seen, within(8.0), heard.now_s).waits}
    assert (rows["label.next"].say, rows["label.next"].values["at"]) == ("next.overdue", expected)


def test_it_says_whether_a_measurement_would_be_enough_and_that_no_forecast_is_published() -> None:
    heard = HeardMachine()
    heard.compensation()
    heard.measurement(sigma=0.5)
    heard.decision(sigma=9.0)
    enough = verdict_of(heard.seen, within(5.0), heard.now_s)
    assert [said.say for said in enough.helps] == ["when.no_forecast", "help.measure"]
    half = float(np.max(half_width(MATRIX, np.full(9, 0.5))))
    too_little = verdict_of(heard.seen, within(0.9 * half), heard.now_s)
    assert [said.say for said in too_little.helps] == ["when.no_forecast", "help.measure_not_enough"]


def test_a_gateway_that_is_connected_and_says_nothing_is_silent() -> None:
    """It publishes its status every 10 s; one that hangs keeps its token."""
    heard = HeardMachine()
    heard.compensation()
    heard.decision()
    site = SiteSeen("talc", now_s=lambda: heard.now_s)
    heard_last = heard.now
    with site.machines() as machines:
        machines["mill"] = heard.seen
    for _ in range(20):
        heard.passes(timedelta(seconds=10.0))
        heard.status()
        heard_last = heard.now
        with site.machines() as machines:
            assert verdict_of(machines["mill"], within(10.0), heard.now_s).word == "word.ready"
    heard.passes(timedelta(seconds=61.0))
    with site.machines() as machines:
        silent = verdict_of(machines["mill"], within(10.0), heard.now_s)
        assert (silent.colour, silent.word, silent.since) == (Colour.AWAY, "word.silent", heard_last)
        assert silent.because[0] == Sentence("because.silent", {"heard": at(heard_last)})
        shown = view(machines["mill"], within(10.0), heard.now_s)
        assert (shown.alive, shown.axes) == (False, ())
    heard.status()
    with site.machines() as machines:
        assert verdict_of(machines["mill"], within(10.0), heard.now_s).word == "word.ready", "it speaks again"


def test_what_is_not_armed_is_said_first() -> None:
    heard, text = HeardMachine(), Text(NoticeCode.OFF_PROBING)
    heard.status(unarmed=(str(text),), unarmed_coded=(coded(text),))
    shown = view(heard.seen, within(10.0), heard.now_s)
    assert shown.unarmed
    assert shown.waits[:2] == (
        SaidRow("label.unarmed", told(text), "notice"),
        SaidRow("label.operator", Sentence("do.unarmed")),
    )
    (listed_one,) = listed({"mill": heard.seen}, {"mill": within(10.0)}, heard.now_s)
    assert listed_one.notices == (Sentence("notice.unarmed", {"text": in_each(text)}),)
    heard.seen.alive = False
    assert not view(heard.seen, within(10.0), heard.now_s).unarmed, "nothing is known of a gateway that is gone"


@pytest.mark.parametrize(("order", "next_one"), [("paused", ["when.next_measurement"]), ("disarmed", [])])
def test_an_order_is_said_and_nothing_else_is_then_said_to_help(order: str, next_one: list[str]) -> None:
    """Ending the order helps most, and a disarmed gateway does not measure: no next measurement is said then."""
    heard = HeardMachine()
    heard.compensation()
    heard.measurement(sigma=0.5)
    heard.decision(sigma=9.0)
    heard.passes(STEP)
    heard.decision(1, sigma=9.0)
    heard.reasons(1)
    given = PauseStanding(by="anna", since=heard.now.isoformat())
    heard.status(paused=given if order == "paused" else None, disarmed=given if order == "disarmed" else None)
    shown = view(heard.seen, within(5.0), heard.now_s)
    assert shown.notices == (Sentence(f"notice.{order}", {"by": ToldName("anna"), "at": at(heard.now)}),)
    assert [said.say for said in shown.verdict.helps] == ["when.no_forecast", *next_one]
    assert shown.verdict.because[-1] == Sentence(f"because.{order}", {"at": at(heard.now)})
    (listed_one,) = listed({"mill": heard.seen}, {"mill": within(5.0)}, heard.now_s)
    assert listed_one.notices == shown.notices


def test_a_gateway_whose_probing_is_not_armed_expects_no_measurement_and_advises_none() -> None:
    def told_with(unarmed: tuple[str, ...]) -> set[str]:
        heard = HeardMachine()
        heard.compensation()
        heard.measurement(sigma=0.5)
        heard.decision(sigma=9.0)
        heard.passes(STEP)
        heard.decision(1, sigma=9.0)
        heard.reasons(1)
        heard.forecast({}, sigma=9.0, measured=0.5, k=1)
        heard.status(unarmed=unarmed, unarmed_coded=tuple(Coded(code, {}) for code in unarmed))
        shown = view(heard.seen, within(5.0), heard.now_s)
        helps = {str(said.values.get("what", said.say)) for said in shown.verdict.helps}
        return helps | {row.label for row in shown.waits}

    of_measurements = {"Word(w='help.probe')", "label.next", "label.waiting", "when.next_measurement"}
    assert told_with(("off_listen",)) >= of_measurements
    assert not told_with(("off_probing",)) & of_measurements


def test_the_list_shows_the_worst_first() -> None:
    red, green, gone = HeardMachine(), HeardMachine(), HeardMachine(alive=False)
    for heard in (red, green):
        heard.compensation()
    red.decision(phase="no_good")
    green.decision()
    machines = {"a": green.seen, "b": green.seen, "c": gone.seen, "d": red.seen}
    viewpoints = dict.fromkeys(machines, within(10.0)) | {"a": within(None)}
    shown = listed(machines, viewpoints, 0.0)
    assert [machine.word for machine in shown] == ["word.not_ready", "word.never", "word.no_tolerance", "word.ready"]


def test_the_course_has_the_estimates_and_the_measurements_at_the_chosen_point() -> None:
    heard = HeardMachine()
    heard.compensation((0.0, 0.0, 30.0))
    heard.measurement(errors=0.0)
    heard.decision(0, Z_ONLY, 0.0)
    heard.passes(STEP)
    heard.decision(1, {"EZ0A": None}, 0.0)
    course = shown_course(heard.seen, within(8.0))
    assert course.without[2] == [30.0, None]
    assert course.left[2] == [0.0, None]
    assert course.half[2] == [0.0, 0.0]
    assert course.measured[2] == [0.0]
