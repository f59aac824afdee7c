"""Beyond the boundary of a control's driver there are only driver errors and answers that the interface allows."""

import logging
import math
from collections.abc import Callable
from dataclasses import fields, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from drivers.base import BadAnswer, DriverError, NoAnswer, Quality
from drivers.nc import (
    AXES,
    LINEAR_AXES,
    FollowsErrors,
    FollowsPosition,
    ForgetsWrites,
    LinearOffsets,
    NcSnapshot,
    NineErrors,
    NotSendable,
    NumericalControl,
    OperatingMode,
    ProbingState,
    ProgramState,
    RequestStatus,
    WatchdogTerms,
)
from gateway.nc.boundary import contained_control
from gateway.runtime.boundary import UnexpectedError
from tests.benches.answering_control import AnsweringControl, AnsweringErrors, AnsweringLate, AnsweringSlopes
from tests.benches.fake_agent import agent_and_driver
from tests.benches.nc_link_bench import LinkBench, answer_wrongly

SNAPSHOT = NcSnapshot(datetime(2026, 1, 1, tzinfo=UTC), 5.0, dict.fromkeys(AXES, 1.0), {"coolant": 1.0})
DONE = RequestStatus(7, ProbingState.DONE, ((1.0, 2.0, 3.0),))
LINEAR = LinearOffsets((1.0, 2.0, 3.0), ((0.1, 0.2, 0.3),) * 3, (4.0, 5.0, 6.0))
NOTHING = NineErrors((0.0,) * 9, 120.0, (50.0, 50.0, 50.0))


def behind(control: AnsweringControl) -> NumericalControl:
    return contained_control(control)


def sloped(**answers: object) -> tuple[AnsweringSlopes, FollowsPosition]:
    """answers: replace good ones when the control is known to take slopes"""
    control = AnsweringSlopes({"pairs": frozenset(), "reference_mm": (0.0, 0.0, 0.0), "reach_mm": (1.0, 1.0, 1.0)})
    contained = behind(control)
    assert isinstance(contained, FollowsPosition)
    control.answers |= answers
    control.asked.clear()
    return control, contained


def following(**answers: object) -> tuple[AnsweringErrors, FollowsErrors]:
    control = AnsweringErrors(answers)
    contained = behind(control)
    assert isinstance(contained, FollowsErrors)
    control.asked.clear()
    return control, contained


async def test_every_operation_passes_what_it_is_given_and_what_is_answered() -> None:
    answers = {"snapshot": SNAPSHOT, "probing_status": DONE, "read_compensation": (1, 2.0, 3), "heartbeat": True}
    control = AnsweringControl(dict(answers))
    nc, terms = behind(control), WatchdogTerms(5.0, 1.0)
    assert not isinstance(nc, FollowsPosition | FollowsErrors)
    await nc.connect()
    assert await nc.snapshot() is SNAPSHOT
    await nc.request_probing(7)
    assert await nc.probing_status(7) is DONE
    await nc.withdraw_probing(7)
    await nc.write_compensation((1.0, 2.0, 3.0))
    assert await nc.read_compensation() == (1.0, 2.0, 3.0)
    await nc.claim(5, terms, 4)
    assert await nc.heartbeat(5) is True
    await nc.release(5)
    await nc.close()
    assert control.asked == [
        ("connect",), ("snapshot",), ("request_probing", 7), ("probing_status", 7), ("withdraw_probing", 7),
        ("write_compensation", (1.0, 2.0, 3.0)), ("read_compensation",), ("claim", 5, terms, 4), ("heartbeat", 5),
        ("release", 5), ("close",),
    ]  # fmt: skip


async def test_slopes_pass_too() -> None:
    pairs, reference, reach = frozenset({(0, 2), (2, 1)}), (1.0, 2.0, 3.0), (4.0, 5.0, 6.0)
    control, nc = sloped(pairs=pairs, reference_mm=reference, reach_mm=reach, read_linear=LINEAR)
    assert (nc.pairs, nc.reference_mm, nc.reach_mm) == (pairs, reference, reach)
    await nc.write_linear(LINEAR)
    assert await nc.read_linear() == LINEAR
    assert control.asked[-2:] == [("write_linear", LINEAR), ("read_linear",)]


async def test_the_nine_errors_pass_too() -> None:
    control, nc = following(error_reach_mm=(300.0, 400.0), slopes=None, read_errors=list(range(9)))
    assert nc.error_reach_mm == (300.0, 400.0)
    assert nc.slopes is None
    await nc.write_errors(NOTHING)
    assert await nc.read_errors(120.0) == tuple(map(float, range(9)))
    assert control.asked[-2:] == [("write_errors", NOTHING), ("read_errors", 120.0)]


async def test_slopes_of_a_control_that_could_take_the_nine_errors_are_behind_the_boundary_too() -> None:
    slopes = AnsweringSlopes({"read_linear": "slopes", "reach_mm": (1.0, 1.0, 0.0)})
    control, nc = following(error_reach_mm=None, slopes=slopes)
    assert nc.slopes is not None
    with pytest.raises(UnexpectedError, match="read_linear"):
        await nc.slopes.read_linear()
    with pytest.raises(UnexpectedError, match="reach_mm"):
        _ = nc.slopes.reach_mm
    assert control.answers["slopes"] is slopes


OPERATIONS: dict[str, Callable[[Any], Any]] = {
    "connect": lambda nc: nc.connect(),
    "close": lambda nc: nc.close(),
    "snapshot": lambda nc: nc.snapshot(),
    "request_probing": lambda nc: nc.request_probing(7),
    "probing_status": lambda nc: nc.probing_status(7),
    "withdraw_probing": lambda nc: nc.withdraw_probing(7),
    "write_compensation": lambda nc: nc.write_compensation((0.0, 0.0, 0.0)),
    "read_compensation": lambda nc: nc.read_compensation(),
    "claim": lambda nc: nc.claim(5, WatchdogTerms(5.0, 1.0)),
    "heartbeat": lambda nc: nc.heartbeat(5),
    "release": lambda nc: nc.release(5),
    "write_linear": lambda nc: nc.write_linear(LINEAR),
    "read_linear": lambda nc: nc.read_linear(),
    "write_errors": lambda nc: nc.write_errors(NOTHING),
    "read_errors": lambda nc: nc.read_errors(120.0),
}


def with_operation(operation: str, answer: object) -> NumericalControl:
    if operation.endswith("_linear"):
        return sloped(**{operation: answer})[1]
    return (
        following(**{operation: answer})[1]
        if operation.endswith("_errors")
        else behind(AnsweringControl({operation: answer}))
    )


@pytest.mark.parametrize("operation", OPERATIONS)
async def test_any_exception_becomes_the_controls_fault_with_its_cause(operation: str) -> None:
    error = IndexError("list index out of range")
    with pytest.raises(UnexpectedError, match=f"unexpected IndexError in {operation}: list index") as told:
        await OPERATIONS[operation](with_operation(operation, error))
    assert told.value.device == "nc"
    assert told.value.__cause__ is error


@pytest.mark.parametrize("error", [NoAnswer("nothing", device="nc"), NotSendable("too large"), MemoryError()])
async def test_what_is_declared_passes_as_it_is(error: Exception) -> None:
    with pytest.raises(type(error)) as told:
        await with_operation("write_compensation", error).write_compensation((0.0, 0.0, 0.0))
    assert told.value is error


async def test_the_traceback_of_each_place_is_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    control = AnsweringControl()
    nc = behind(control)
    for operation, error in (
        ("snapshot", ValueError("a")), ("snapshot", ValueError("b")), ("snapshot", KeyError("X")),
        ("release", ValueError("a")), ("snapshot", KeyError("Y")), ("release", ValueError("c")),
    ):  # fmt: skip
        control.answers[operation] = error
        with pytest.raises(UnexpectedError):
            await OPERATIONS[operation](nc)
    assert [record.getMessage() for record in caplog.records if record.exc_info] == [
        "NC: unexpected ValueError in snapshot", "NC: unexpected KeyError in snapshot",
        "NC: unexpected ValueError in release",
    ]  # fmt: skip
    assert {record.levelno for record in caplog.records} == {logging.ERROR}


class Unreliable(AnsweringControl):
    """Raises the same at two lines, in turn, for the same call."""

    def answer(self, operation: str, *given: object) -> Any:
        self.asked.append((operation, *given))
        if len(self.asked) % 2:
            raise ValueError("odd")
        raise ValueError("even")


async def test_a_place_is_the_line_that_raises(caplog: pytest.LogCaptureFixture) -> None:
    nc = behind(Unreliable())
    for _ in range(4):
        with pytest.raises(UnexpectedError):
            await nc.release(5)
    told = [record.exc_info[1] for record in caplog.records if record.exc_info]
    assert [str(error) for error in told] == ["odd", "even"]


@pytest.mark.parametrize("answer", [1, "yes", None, 1.0])
async def test_only_true_means_that_the_watchdog_is_active(answer: object) -> None:
    assert await with_operation("heartbeat", answer).heartbeat(5) is False


WRONG_FIELDS: dict[str, list[object]] = {
    "time": [None, "2026-01-01", 0.0, datetime(2026, 1, 1)],  # noqa: DTZ001 - without a zone is the point
    "monotonic_s": [None, "5", math.nan, math.inf, 10**400],
    "positions": [None, "X", {}, {"X": 0.0}, dict.fromkeys(AXES, math.nan), dict.fromkeys(AXES, "1")],
    "states": [None, {"coolant": math.inf}, {"coolant": None}, {"coolant": 10**400}],
    "not_known": [None, ("coolant",), {"coolant": None}, {1: "'MIST'"}],
    "mode": [None, "auto", 2],
    "program": [None, "running", 2],
    "tool": [1.5, "T1"],
    "probe_in_spindle": [0, 1, "no"],
    "alarms": [None, 0, "700000", [700000]],
    "ready": [0, 1, "false", math.nan],
    "cannot_probe": [False, 0],
    "cannot_probe_code": [None, 0],
    "probing": [0, 1, "no"],
    "quality": [None, "good"],
}


def test_every_field_of_a_snapshot_has_wrong_values() -> None:
    assert set(WRONG_FIELDS) == {each.name for each in fields(NcSnapshot)}


@pytest.mark.parametrize(("name", "value"), [(name, value) for name, found in WRONG_FIELDS.items() for value in found])
async def test_a_snapshot_with_a_field_that_the_interface_excludes_is_refused(name: str, value: object) -> None:
    wrong = replace(SNAPSHOT, **{name: value})  # type: ignore[arg-type]
    with pytest.raises(UnexpectedError, match="in snapshot"):
        await with_operation("snapshot", wrong).snapshot()


async def test_every_allowed_value_of_a_snapshot_passes() -> None:
    for changes in (
        *({"ready": each, "probing": each, "probe_in_spindle": each} for each in (True, False, None)),
        {"cannot_probe": "", "not_known": {"coolant": "'MIST'"}, "alarms": (1, 2), "tool": 5, "monotonic_s": 0},
        {"mode": OperatingMode.JOG, "program": ProgramState.WAITING, "quality": Quality.STALE, "states": {}},
    ):
        snapshot = replace(SNAPSHOT, **changes)  # type: ignore[arg-type]
        assert await with_operation("snapshot", snapshot).snapshot() is snapshot


async def test_a_zero_for_not_ready_writes_nothing_and_does_not_end_the_link() -> None:
    bench = LinkBench("compensate")
    async with bench.following(6.0, until_s=3.0):
        written = len(bench.control.writes)
        repair = answer_wrongly(bench, "snapshot", lambda s: replace(s, ready=0))
        await bench.clock.run_until(10.0)
        assert len(bench.control.writes) == written
        assert bench.link.present is None
        repair()
        await bench.clock.run_until(50.0)
        assert bench.control.in_force == (0.0, 0.0, 6.0)


@pytest.mark.parametrize("axis", LINEAR_AXES)
@pytest.mark.parametrize("far", [-2e5, 1e300, 10**300])
async def test_a_position_beyond_any_machine_is_a_bad_answer_that_names_the_axis(axis: str, far: float) -> None:
    absurd = replace(SNAPSHOT, positions=SNAPSHOT.positions | {axis: far})
    with pytest.raises(BadAnswer, match=f"position {axis} = .* mm: no axis is so long"):
        await with_operation("snapshot", absurd).snapshot()


async def test_a_long_axis_and_a_table_that_has_turned_often_pass() -> None:
    large = replace(SNAPSHOT, positions={"X": 9e4, "Y": -9e4, "Z": 1e5, "A": -1e7, "C": 1e7})
    assert await with_operation("snapshot", large).snapshot() is large


async def test_an_agent_s_absurd_position_is_a_bad_answer(tmp_path: Path) -> None:
    async with agent_and_driver(tmp_path) as (agent, nc):
        agent.answers["status"] = {"positions": dict.fromkeys("XYZAC", 0.0) | {"X": 1e300}, "states": {}}
        with pytest.raises(BadAnswer, match=r"position X = 1e\+300 mm: no axis is so long"):
            await contained_control(nc).snapshot()


WRONG_STATUS: list[dict[str, object]] = [
    {"state": "finished"}, {"state": None}, {"number": 6}, {"number": 8}, {"number": None}, {"reason": None},
    {"reason": 3}, {"spread_mm": math.nan}, {"spread_mm": "0.001"}, {"spread_mm": 10**400}, {"in_force_um": (0.0, 0.0)},
    {"in_force_um": 0.0}, {"in_force_um": (0.0, 0.0, math.inf)}, {"in_force_um": ("x", "y", "z")},
]  # fmt: skip


@pytest.mark.parametrize("changes", WRONG_STATUS)
async def test_a_state_of_a_request_that_the_interface_excludes_is_refused(changes: dict[str, object]) -> None:
    wrong = replace(DONE, **changes)  # type: ignore[arg-type]
    with pytest.raises(UnexpectedError, match="in probing_status"):
        await with_operation("probing_status", wrong).probing_status(7)


async def test_no_state_of_a_request_is_refused() -> None:
    with pytest.raises(UnexpectedError, match="unexpected AttributeError in probing_status"):
        await with_operation("probing_status", None).probing_status(7)


async def test_every_allowed_state_of_a_request_passes() -> None:
    for status in (*(RequestStatus(7, state) for state in ProbingState), replace(DONE, spread_mm=0.0),
                   replace(DONE, in_force_um=(1.0, 2.0, 3.0), reason="chip")):  # fmt: skip
        assert await with_operation("probing_status", status).probing_status(7) is status
    large = replace(DONE, number=int("70000"))
    assert await with_operation("probing_status", large).probing_status(int("70000")) is large


@pytest.mark.parametrize("answer", [None, 5, (1.0,) * 8, (1.0,) * 10, ("x",) * 9, (10**400,) * 9])
async def test_anything_but_nine_numbers_is_refused(answer: object) -> None:
    _, nc = following(read_errors=answer)
    with pytest.raises(UnexpectedError, match="in read_errors"):
        await nc.read_errors(120.0)


WRONG_SLOPES: list[dict[str, object]] = [
    {"k0_um": (1.0, 2.0)}, {"k0_um": ("x", "y", "z")}, {"slope_um_per_mm": ((0.0,) * 3,) * 2},
    {"slope_um_per_mm": ((0.0,) * 2,) * 3}, {"reference_mm": None},
]  # fmt: skip


@pytest.mark.parametrize("changes", WRONG_SLOPES)
async def test_slopes_of_another_shape_are_refused(changes: dict[str, object]) -> None:
    _, nc = sloped(read_linear=replace(LINEAR, **changes))  # type: ignore[arg-type]
    with pytest.raises(UnexpectedError, match="in read_linear"):
        await nc.read_linear()


@pytest.mark.parametrize("answer", [None, (1.0,), ((1.0, 2.0, 3.0), ((0.0,) * 3,) * 3, (0.0, 0.0, 0.0))])
async def test_anything_but_slopes_is_refused(answer: object) -> None:
    _, nc = sloped(read_linear=answer)
    with pytest.raises(UnexpectedError, match="in read_linear"):
        await nc.read_linear()


@pytest.mark.parametrize(
    ("name", "value"),
    [("pairs", None), ("pairs", {(0, 3)}), ("pairs", {(3, 0)}), ("pairs", {(-1, 0)}), ("pairs", {(0, 1, 2)}),
     ("reference_mm", (1.0, 2.0)),
     ("reference_mm", None), ("reach_mm", (1.0, 2.0, 0.0)), ("reach_mm", (1.0, 2.0, math.inf)),
     ("reach_mm", (1.0, 2.0, -1.0)), ("reach_mm", (1.0, 2.0, float("inf"))),
     ("reach_mm", (1.0, math.nan, 2.0)), ("reach_mm", ValueError("unknown axis"))],
)  # fmt: skip
def test_what_a_control_with_slopes_says_of_itself_is_checked(name: str, value: object) -> None:
    _, nc = sloped(**{name: value})
    with pytest.raises(UnexpectedError, match=f"in {name}"):
        getattr(nc, name)


@pytest.mark.parametrize(
    "value",
    [(1.0,), (1.0, -1.0), (-1.0, 1.0), (math.nan, 1.0), (1.0, math.inf), (math.inf, 1.0), (1.0, float("inf")),
     (float("inf"), 1.0), "far", 5],
)  # fmt: skip
def test_an_invalid_reach_is_refused(value: object) -> None:
    control, nc = following()
    control.answers["error_reach_mm"] = value
    with pytest.raises(UnexpectedError, match="in error_reach_mm"):
        _ = nc.error_reach_mm


@pytest.mark.parametrize("value", [None, (0.0, 0.0), (0.0, 400.0)])
def test_a_valid_reach_passes(value: object) -> None:
    assert following(error_reach_mm=value)[1].error_reach_mm == value


@pytest.mark.parametrize("value", [math.nan, -1.0, None, "soon"])
def test_what_is_no_time_for_a_late_write_is_refused(value: object) -> None:
    control = AnsweringLate({"late_write_s": 3})
    nc = behind(control)
    assert isinstance(nc, ForgetsWrites)
    assert nc.late_write_s == 3.0
    control.answers["late_write_s"] = value
    with pytest.raises(UnexpectedError, match="in late_write_s"):
        _ = nc.late_write_s


@pytest.mark.parametrize("name", ["error_reach_mm", "slopes"])
def test_what_a_control_that_follows_errors_raises_about_itself_is_its_fault(name: str) -> None:
    control, nc = following()
    for error, expected in ((KeyError("reach"), UnexpectedError), (NoAnswer("nothing"), NoAnswer)):
        control.answers[name] = error
        with pytest.raises(expected) as told:
            getattr(nc, name)
        assert isinstance(told.value, DriverError)
    control.answers[name] = MemoryError()
    with pytest.raises(MemoryError):
        getattr(nc, name)
