"""When a measurement is requested: never in a cut, preferably at rest, after a while in any case; and why not."""

import math
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest

from drivers.nc import NcSnapshot, OperatingMode, ProgramState
from gateway.config.sections import Probing
from gateway.model.codes import NoticeCode
from gateway.model.probing import End, Outlook
from gateway.model.standing import Standing
from gateway.model.text import Text, plain
from gateway.model.wording import event_of
from gateway.nc.probing.schedule import Bulletin, Moment, ProbingSchedule, moment, schedule_of
from simulators.nc import Activity, CycleSettings, DayPart, LoadCase, MachineState, MeanLoads, Nck
from talc.frame import Event, EventKind, Why
from tests.benches.still_machine import StillMachine

POSITIONS = {"X": 0.0, "Y": 0.0, "Z": 0.0, "A": 0.0, "C": 0.0}
IDLE = NcSnapshot(
    datetime(2026, 3, 2, tzinfo=UTC), 0.0, POSITIONS, {"spindle_speed": 0.0, "speed_X": 0.0},
    OperatingMode.AUTO, ProgramState.ABORTED, tool=3,
)  # fmt: skip
CUTTING = replace(IDLE, program=ProgramState.RUNNING, states={"spindle_speed": 8000.0, "speed_X": 900.0})
OTHER_TOOL = replace(CUTTING, tool=4)


def schedule(retries: int = 2) -> ProbingSchedule:
    return schedule_of(Probing(retries=retries))


@pytest.mark.parametrize(
    ("before", "now", "expected"),
    [
        (None, IDLE, Moment.IDLE),
        (IDLE, IDLE, Moment.IDLE),
        (CUTTING, IDLE, Moment.PROGRAM_END),
        (None, CUTTING, Moment.CUT),
        (CUTTING, OTHER_TOOL, Moment.TOOL_CHANGE),
        (OTHER_TOOL, OTHER_TOOL, Moment.CUT),
        (CUTTING, replace(OTHER_TOOL, tool=None), Moment.CUT),
        (CUTTING, replace(CUTTING, program=ProgramState.STOPPED), Moment.CUT),  # stopped with the spindle turning
        (CUTTING, replace(IDLE, program=ProgramState.INTERRUPTED), Moment.CUT),
        (IDLE, replace(IDLE, program=ProgramState.UNKNOWN), Moment.CUT),
        (CUTTING, replace(IDLE, program=ProgramState.WAITING), Moment.CUT),
        (replace(IDLE, program=ProgramState.WAITING), IDLE, Moment.PROGRAM_END),
        (IDLE, replace(IDLE, states={"speed_C": 300.0}), Moment.CUT),
        (IDLE, replace(IDLE, states={}), Moment.IDLE),
        (IDLE, replace(IDLE, states={}, not_known={"spindle_speed": "'FAST'"}), Moment.CUT),
        (IDLE, replace(IDLE, not_known={"coolant": "'MIST'"}), Moment.IDLE),
    ],
)
def test_the_moment(before: NcSnapshot | None, now: NcSnapshot, expected: Moment) -> None:
    assert moment(before, now) is expected


def test_nothing_is_due_that_nobody_wants() -> None:
    plan = schedule()
    assert plan.look(IDLE, 0.0).standing is Standing.NOT_WANTED
    assert not plan.wanted
    with pytest.raises(ValueError, match="nothing is wanted"):
        plan.asked()


def test_a_routine_measurement_waits_in_a_cut_and_takes_the_end_of_the_program() -> None:
    plan = schedule()
    plan.want(Why.INTERVAL, 0.0)
    first = plan.look(CUTTING, 0.0)
    assert first.standing is Standing.WAITING
    assert "idle" in first.reason
    assert plan.look(OTHER_TOOL, 100.0).standing is Standing.WAITING  # too early for a tool change
    assert plan.look(IDLE, 200.0).standing is Standing.DUE


def test_after_a_while_a_tool_change_will_do() -> None:
    plan = schedule()
    plan.want(Why.NOVELTY, 0.0)
    assert plan.look(CUTTING, 601.0).standing is Standing.WAITING
    assert plan.look(OTHER_TOOL, 610.0).standing is Standing.DUE


def test_in_the_end_it_insists_and_informs_the_operator() -> None:
    plan = schedule()
    plan.want(Why.INTERVAL, 0.0)
    for now in range(0, 1800, 60):
        assert plan.look(CUTTING, float(now)).standing is Standing.WAITING
    due = plan.look(CUTTING, 1800.0)
    assert due.standing is Standing.DUE
    assert "waited 30 min" in due.operator


def test_waiting_goes_on_when_the_reason_to_measure_changes_and_begins_again_after_it_ends() -> None:
    plan = schedule()
    plan.want(Why.NOVELTY, 0.0)
    plan.look(CUTTING, 0.0)
    plan.want(Why.INTERVAL, 1500.0)
    assert plan.look(CUTTING, 1800.0).standing is Standing.DUE
    plan.want(None, 1801.0)
    assert plan.look(IDLE, 1801.0).standing is Standing.NOT_WANTED
    plan.want(Why.INTERVAL, 2100.0)
    assert plan.look(CUTTING, 2100.0).standing is Standing.WAITING


@pytest.mark.parametrize("why", [Why.CALIBRATION, Why.NO_GOOD, Why.RETRY])
def test_what_belongs_to_the_next_step_does_not_wait(why: Why) -> None:
    plan = schedule()
    plan.want(why, 0.0)
    assert plan.look(CUTTING, 0.0) == Outlook(Standing.DUE, why)


@pytest.mark.parametrize("mode", OperatingMode)
def test_a_control_that_says_it_can_begin_is_asked_in_any_mode_but_not_in_a_cut(mode: OperatingMode) -> None:
    plan = schedule()
    plan.want(Why.INTERVAL, 0.0)
    jogging = replace(IDLE, mode=mode, cannot_probe="", states={"speed_X": 500.0})
    assert plan.look(jogging, 0.0).standing is Standing.WAITING
    assert plan.look(replace(CUTTING, mode=mode, cannot_probe=""), 1.0).standing is Standing.WAITING
    assert plan.look(replace(IDLE, mode=mode, cannot_probe=""), 2.0).standing is Standing.DUE


@pytest.mark.parametrize(
    ("snapshot", "reason"),
    [
        (None, "cannot be reached"),
        (replace(IDLE, alarms=(21612, 3000)), "alarm 21612, 3000"),
        (replace(IDLE, mode=OperatingMode.JOG), "is in JOG, not in AUTO"),
        (replace(IDLE, mode=OperatingMode.MDA), "is in MDA, not in AUTO"),
        (replace(IDLE, cannot_probe="nobody agrees"), "nobody agrees"),
    ],
)
def test_what_blocks_is_named_once_and_reported_to_the_operator_when_it_lasts(
    snapshot: NcSnapshot | None, reason: str
) -> None:
    plan, bulletin = schedule(), Bulletin()
    plan.want(Why.CALIBRATION, 0.0)
    events: list[Event] = []
    for now in range(0, 2400, 10):
        outlook = plan.look(snapshot, float(now))
        assert outlook.standing is Standing.BLOCKED
        assert reason in outlook.reason
        events += bulletin.of(outlook)
    assert [e.kind for e in events] == [EventKind.PROBLEM, EventKind.OPERATOR]
    assert all(reason in e.text for e in events)
    plan.look(IDLE, 2400.0)
    plan.asked()
    ended = bulletin.of(plan.ended(End.MEASURED, plain(""), 2520.0))
    assert [e.kind for e in ended] == [EventKind.PROBLEM_ENDED]


def test_a_refusal_such_as_a_missing_probe_is_reported_once_and_asked_again_at_the_next_step() -> None:
    plan, bulletin = schedule(), Bulletin()
    plan.want(Why.INTERVAL, 0.0)
    events: list[Event] = []
    for now in (0.0, 300.0, 600.0):
        events += bulletin.of(plan.look(IDLE, now))
        assert plan.asked() is Why.INTERVAL  # a refusal is no rejected result
        assert plan.look(IDLE, now + 1.0).standing is Standing.ASKED
        events += bulletin.of(
            plan.ended(End.REFUSED, plain("the control refused the cycle: the touch probe is missing"), now)
        )
    assert [e.text for e in events] == ["probing: the control refused the cycle: the touch probe is missing"]


def test_rejected_results_are_asked_for_again_a_limited_number_of_times() -> None:
    plan, bulletin = schedule(retries=2), Bulletin()
    asked: list[tuple[float, Why]] = []
    operator: list[Event] = []
    for step in range(40):
        now = step * 300.0
        plan.want(Why.INTERVAL, now)
        outlook = plan.look(CUTTING if asked else IDLE, now)  # a retry does not wait for a better moment
        operator += [e for e in bulletin.of(outlook) if e.kind is EventKind.OPERATOR]
        if outlook.standing is Standing.DUE:
            asked.append((now, plan.asked()))
            end = plan.ended(End.REJECTED, plain("the touches do not repeat"), now + 120.0)
            operator += [e for e in bulletin.of(end) if e.kind is EventKind.OPERATOR]
        if now == 3900.0:
            break
    assert asked == [(0.0, Why.INTERVAL), (300.0, Why.RETRY), (600.0, Why.RETRY)]
    assert len(operator) == 1
    assert "3 measurements in a row could not be used; the last: the touches do not repeat" in operator[0].text
    assert plan.look(CUTTING, 4200.0).standing is Standing.BLOCKED
    assert "pause after 3 rejected results" in plan.look(CUTTING, 4319.0).reason
    assert plan.look(IDLE, 4320.0) == Outlook(Standing.DUE, Why.INTERVAL)


def test_a_good_result_forgets_the_rejected_ones() -> None:
    plan = schedule(retries=1)
    for now in (0.0, 1000.0, 2000.0):
        plan.want(Why.INTERVAL, now)
        plan.look(IDLE, now)
        plan.asked()
        assert not plan.ended(End.REJECTED, plain("dirt"), now).operator
        plan.look(IDLE, now + 300.0)
        assert plan.asked() is Why.RETRY
        plan.ended(End.MEASURED, plain(""), now + 420.0)
    assert not plan.wanted


@pytest.mark.parametrize("end", [End.REJECTED, End.REFUSED])
def test_a_measurement_no_longer_wanted_while_requested_is_not_requested_again(end: End) -> None:
    plan, bulletin = schedule(), Bulletin()
    plan.want(Why.NO_GOOD, 0.0)
    plan.look(CUTTING, 0.0)
    plan.asked()
    plan.want(None, 100.0)  # a training has begun meanwhile
    outlook = plan.ended(end, plain("dirt"), 120.0)
    assert outlook == Outlook(Standing.NOT_WANTED, None)
    assert bulletin.of(outlook) == ()
    plan.want(Why.UNCERTAINTY, 86400.0)
    assert plan.look(CUTTING, 86400.0).standing is Standing.WAITING, "it is no repeat: the cut is not disturbed"
    plan.look(IDLE, 86500.0)
    assert plan.asked() is Why.UNCERTAINTY


@pytest.mark.parametrize(
    ("wanted", "seen", "said"),
    [
        (Why.INTERVAL, CUTTING, NoticeCode.PROBING_FREE),
        (None, None, NoticeCode.PROBING_MOOT),
    ],
)
def test_a_problem_that_may_go_on_is_not_said_to_be_over(
    wanted: Why | None, seen: NcSnapshot | None, said: NoticeCode
) -> None:
    plan, bulletin = schedule(), Bulletin()
    plan.want(Why.INTERVAL, 0.0)
    assert [event.kind for event in bulletin.of(plan.look(None, 0.0))] == [EventKind.PROBLEM]
    plan.want(wanted, 60.0)
    ended = event_of(EventKind.PROBLEM_ENDED, Text(said, reason=Text(NoticeCode.NC_UNREACHABLE)))
    assert bulletin.of(plan.look(seen, 60.0)) == (ended,)


def test_repeats_end_when_the_measurement_is_no_longer_wanted() -> None:
    plan = schedule()
    plan.want(Why.NO_GOOD, 0.0)
    plan.look(CUTTING, 0.0)
    plan.asked()
    assert plan.ended(End.REJECTED, plain("dirt"), 120.0).standing is Standing.WAITING
    plan.want(None, 300.0)
    assert plan.look(CUTTING, 300.0) == Outlook(Standing.NOT_WANTED, None)
    plan.want(Why.UNCERTAINTY, 86400.0)
    assert plan.look(CUTTING, 86400.0).standing is Standing.WAITING


def test_the_pause_after_rejected_results_outlasts_the_reason_to_measure() -> None:
    plan, bulletin = schedule(retries=0), Bulletin()
    plan.want(Why.NO_GOOD, 0.0)
    plan.look(CUTTING, 0.0)
    plan.asked()
    plan.want(None, 100.0)
    outlook = plan.ended(End.REJECTED, plain("dirt"), 120.0)
    assert outlook.standing is Standing.NOT_WANTED
    assert [event.kind for event in bulletin.of(outlook)] == [EventKind.OPERATOR]  # the sphere is dirty all the same
    plan.want(None, 300.0)
    plan.want(Why.INTERVAL, 600.0)
    paused = plan.look(IDLE, 600.0)
    assert (paused.standing, paused.rejected) == (Standing.BLOCKED, 1)
    assert paused.reason == "pause after 1 rejected result: dirt"
    assert plan.look(IDLE, 3720.0) == Outlook(Standing.DUE, Why.INTERVAL)


@pytest.mark.parametrize(
    ("prefer", "insist", "retries", "pause"),
    [(700.0, 600.0, 1, 1.0), (-1.0, 600.0, 1, 1.0), (1.0, 2.0, -1, 1.0), (1.0, 2.0, 1, math.nan)],
)
def test_invalid_settings(prefer: float, insist: float, retries: int, pause: float) -> None:
    with pytest.raises(ValueError, match="expected"):
        ProbingSchedule(prefer_idle_s=prefer, insist_after_s=insist, urgent_excess=2.0, retries=retries, pause_s=pause)


# A machine's day ---------------------------------------------------------------------------------------------------


PROGRAMS = {1: ProgramState.INTERRUPTED, 2: ProgramState.STOPPED, 3: ProgramState.RUNNING}


def seen(state: MachineState) -> NcSnapshot:
    loads = state.loads
    states = {
        "spindle_speed": loads.spindle, "speed_X": loads.x, "speed_Y": loads.y, "speed_Z": loads.z,
        "speed_A": loads.a, "speed_C": loads.c,
    }  # fmt: skip
    at = datetime(2026, 3, 2, tzinfo=UTC) + timedelta(seconds=state.time_s)
    return NcSnapshot(
        at, state.time_s, state.positions, states, OperatingMode.AUTO, PROGRAMS[state.program_status], state.tool
    )


def probed(program: LoadCase, hours: float, every_s: float = 7200.0) -> list[tuple[float, float]]:
    """Ask an emulated control as the schedule says, every two hours: (wanted since, cycle began at)."""
    nck, plan = Nck(StillMachine(), program, cycle=CycleSettings()), schedule()
    found: list[tuple[float, float]] = []
    wanted_s, number = 0.0, 0
    for now in range(0, round(hours * 3600), 5):
        nck.advance(float(now))
        if now % every_s == 0:
            plan.want(Why.INTERVAL, float(now))
            wanted_s = float(now)
        if plan.wanted and plan.look(seen(nck.state(float(now))), float(now)).standing is Standing.DUE:
            number += 1
            plan.asked()
            nck.write_r(60, number, float(now))
        if len(nck.cycle.ended) > len(found):
            found.append((wanted_s, nck.cycle.ended[-1][0]))
            plan.ended(End.MEASURED, plain(""), float(now))
    return found


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_over_a_day_no_cycle_begins_in_a_cut_and_none_waits_without_end(seed: int) -> None:
    program = LoadCase.random(seed, 48 * 3600.0)
    found = probed(program, 47.0)
    assert len(found) == 24
    at_rest = 0
    for wanted_s, began in found:
        block = program.at(began)
        assert 0.0 <= began - wanted_s <= 1800.0 + 5.0 + program.operation_s
        at_rest += not block.cutting
        if block.cutting:  # then between two operations
            assert (began - block.start_s) % program.operation_s == pytest.approx(0.0, abs=1e-6)
    # It prefers rest: asking at once would find it as often as the machine rests at all.
    at_once = sum(not program.at(k * 7200.0).cutting for k in range(24))
    assert at_rest >= at_once


def test_a_long_cut_without_tool_change_is_left_at_its_end_only() -> None:
    loads = MeanLoads(x=900.0, spindle=8000.0)
    blocks = [DayPart(0.0, 6000.0, Activity.ROUGHING, loads), DayPart(6000.0, 9e9, Activity.PAUSE, MeanLoads())]
    found = probed(LoadCase(blocks, operation_s=6000.0), 7200.0 / 3600.0)
    assert [began for _, began in found] == [6000.0]


def test_a_command_is_urgent_and_ends_the_pause_after_rejected_results() -> None:
    plan = schedule(retries=0)
    plan.want(Why.INTERVAL, 0.0)
    assert plan.look(IDLE, 0.0).standing is Standing.DUE
    plan.asked()
    plan.ended(End.REJECTED, plain("a chip"), 10.0)
    assert plan.look(IDLE, 20.0).standing is Standing.BLOCKED
    plan.order(30.0)
    due = plan.look(CUTTING, 30.0)
    assert (due.standing, due.why, due.rejected, due.operator) == (Standing.DUE, Why.COMMAND, 0, "")
    assert plan.asked() is Why.COMMAND


def test_the_controller_s_wishes_neither_end_nor_repeat_a_command() -> None:
    plan = schedule()
    plan.order(0.0)
    plan.want(None, 1.0)
    assert plan.look(CUTTING, 2.0).why is Why.COMMAND
    plan.asked()
    plan.want(Why.INTERVAL, 3.0)
    plan.ended(End.REFUSED, plain("not now"), 4.0)
    waits = plan.look(CUTTING, 5.0)
    assert (waits.standing, waits.why) == (Standing.WAITING, Why.INTERVAL)


def test_a_command_that_is_blocked_for_too_long_is_dropped_and_the_operator_is_informed() -> None:
    plan = schedule()
    plan.order(0.0)
    assert plan.look(None, 1799.0).standing is Standing.BLOCKED
    dropped = plan.look(None, 1800.0)
    assert dropped.standing is Standing.NOT_WANTED
    assert dropped.operator == (
        "the measurement that was commanded was not possible for 30 min: the control cannot be reached"
    )
    assert plan.look(IDLE, 1801.0) == Outlook(Standing.NOT_WANTED, None)
