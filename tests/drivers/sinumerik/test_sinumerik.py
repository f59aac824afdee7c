"""The driver and the emulated control in detail, beyond the contract of all controls (test_contract_nc)."""

import math
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.base import BadAnswer, ConnectError, DriverError, Refused
from drivers.nc import OperatingMode, ProbingState, RunsDry
from drivers.sinumerik.control import Sinumerik
from drivers.sinumerik.settings import Handshake, SinumerikSettings
from simulators.nc import User
from simulators.nc.cycle import CycleAnswer, CycleState
from simulators.nc.nck import JOG, R_DRY_RUN, R_REQUEST, R_SPREAD, R_VERSION, R_WITHDRAW
from simulators.nc.variables import ALARMS_SHOWN, DRIVES_ON, AccessRight
from tests.benches.emulated_bench import POSES, OpcUaBench, expected_deviation_um, sinumerik_bench, wired
from tests.benches.manual_clock import ManualClock

pytestmark = pytest.mark.simulated_time


@pytest.fixture
async def bench() -> AsyncIterator[OpcUaBench]:
    async with sinumerik_bench() as bench:
        yield bench


async def test_the_snapshot_shows_what_the_machine_does(bench: OpcUaBench) -> None:
    bench.clock.move_to(30.0)
    snapshot = await bench.nc.snapshot()
    assert snapshot.monotonic_s == 30.0
    assert set(snapshot.positions) == {"X", "Y", "Z", "A", "C"}
    assert snapshot.positions["C"] == pytest.approx(30.0 * 6.0 * 30.0 % 360.0)
    assert snapshot.states == pytest.approx(
        {"spindle_speed": 6000, "coolant": 1, "speed_X": 1200, "speed_Y": 600, "speed_Z": 300}
        | {"speed_A": 2, "speed_C": 30}
    )
    assert snapshot.mode is OperatingMode.AUTO
    assert not snapshot.probe_in_spindle
    assert snapshot.alarms == ()


async def test_a_cycle_goes_from_the_request_to_the_nine_errors_deviations(bench: OpcUaBench) -> None:
    bench.clock.move_to(50.0)
    before = await bench.cycle(1)
    errors = {"EY0A": 4.0, "EZ0A": -7.0, "EX0C": 12.0, "EY0C": 3.0, "EZ0T": 6.0, "ER0T": -2.0}
    bench.plant.errors = errors | {"EA0C": 20.0, "EB0C": -35.0, "EC0C": 50.0}
    after = await bench.cycle(2)
    assert before.centres_mm is not None
    assert after.centres_mm is not None
    found = (np.array(after.centres_mm) - np.array(before.centres_mm)) * 1e3
    expected = [expected_deviation_um(bench.plant.errors, a, c) for a, c in POSES]
    np.testing.assert_allclose(found, expected, atol=1e-6)


async def test_the_cycle_waits_for_a_safe_point_and_takes_two_minutes(bench: OpcUaBench) -> None:
    bench.clock.move_to(50.0)  # safe points at 80, 120, ...
    await bench.nc.request_probing(5)
    seen = []
    for now in (79.0, 81.0, 95.0, 199.0, 201.0):
        bench.clock.move_to(now)
        seen.append((await bench.nc.probing_status(5)).state)
    assert seen == [
        ProbingState.REQUESTED,
        ProbingState.ACCEPTED,
        ProbingState.RUNNING,
        ProbingState.RUNNING,
        ProbingState.DONE,
    ]
    assert len(bench.plant.asked_at_s) == len(POSES)
    assert 80.0 < min(bench.plant.asked_at_s) < max(bench.plant.asked_at_s) < 200.0


async def test_the_machine_probes_instead_of_cutting_and_then_goes_on(bench: OpcUaBench) -> None:
    await bench.nc.request_probing(5)
    bench.clock.move_to(100.0)
    probing = await bench.nc.snapshot()
    bench.clock.move_to(130.0)
    cutting = await bench.nc.snapshot()
    assert probing.probe_in_spindle
    assert probing.states["spindle_speed"] == 0.0
    assert (round(probing.positions["A"]), round(probing.positions["C"])) in POSES
    assert not cutting.probe_in_spindle
    assert cutting.states["spindle_speed"] == 6000.0


async def test_an_old_result_is_never_taken_for_a_new_one(bench: OpcUaBench) -> None:
    assert (await bench.cycle(1)).state is ProbingState.DONE
    await bench.nc.request_probing(2)
    status = await bench.nc.probing_status(2)
    assert status.state in (ProbingState.REQUESTED, ProbingState.ACCEPTED)
    assert status.centres_mm is None
    bench.clock.move_to(bench.clock.now + 200.0)
    await bench.nc.probing_status(2)
    assert (await bench.nc.probing_status(1)).state is ProbingState.IDLE


@pytest.mark.parametrize("wait_s", [0.0, 200.0])
async def test_a_number_cannot_be_used_twice_in_a_row(bench: OpcUaBench, wait_s: float) -> None:
    await bench.nc.request_probing(9)
    bench.clock.move_to(wait_s)
    with pytest.raises(Refused, match="request number 9"):
        await bench.nc.request_probing(9)


async def test_the_number_of_a_result_that_is_still_shown_cannot_be_used_again(bench: OpcUaBench) -> None:
    assert (await bench.cycle(9)).state is ProbingState.DONE
    bench.clock.move_to(bench.clock.now + 10.0)
    await bench.nc.request_probing(10)  # waits for a safe point
    with pytest.raises(Refused, match="request number 9"):
        await bench.nc.request_probing(9)


async def test_refused_when_an_alarm_is_active(bench: OpcUaBench) -> None:
    bench.control.nck.raise_alarm(21612, bench.clock.now)
    status = await bench.cycle(1)
    assert status.state is ProbingState.REFUSED
    assert "alarm" in status.reason
    assert (await bench.nc.snapshot()).alarms == (21612,)
    bench.control.nck.clear_alarms(bench.clock.now)
    assert (await bench.cycle(2)).state is ProbingState.DONE


@pytest.mark.parametrize("stale", [0.0, 1.0, 2.0, 2.3, 3.0, 7.0, math.nan, math.inf])
async def test_an_older_program_gets_no_dry_run_whatever_stands_in_the_parameter_of_the_version(
    stale: float, bench: OpcUaBench
) -> None:
    """It would touch: R89 outlasts power off and an exchange of the programs, or is a part program's."""
    nck = bench.control.nck
    nck.version, nck.r[R_VERSION] = 0, stale
    if stale != 2.0:
        with pytest.raises(Refused, match="R89"):
            await bench.nc.request_probing(1, 50.0)
    else:  # it has to show it again
        await bench.nc.request_probing(1, 50.0)
        for _ in range(5):
            bench.clock.move_to(bench.clock.now + 200.0)
            assert (await bench.nc.probing_status(1)).state is ProbingState.REQUESTED
        await bench.nc.withdraw_probing(1)
        assert (await bench.nc.probing_status(1)).state is ProbingState.IDLE
    assert (nck.r[R_REQUEST], nck.r[R_WITHDRAW], nck.r[R_DRY_RUN], len(bench.plant.asked_at_s)) == (0.0, 0.0, 0.0, 0)
    assert (await bench.cycle(2)).state is ProbingState.DONE, "it measures without delay"


@pytest.mark.parametrize("version", [2.3, 3.0, 7.0, math.nan])
async def test_a_program_that_shows_another_version_while_a_dry_run_waits_gets_none(
    version: float, bench: OpcUaBench
) -> None:
    nck = bench.control.nck
    nck.version = 0
    await bench.nc.request_probing(1, 50.0)
    nck.r[R_VERSION] = version
    with pytest.raises(Refused, match="R89"):
        await bench.nc.probing_status(1)
    await bench.nc.withdraw_probing(1)
    assert (nck.r[R_REQUEST], nck.r[R_WITHDRAW]) == (0.0, 0.0), "the control knows of nothing"


async def test_a_dry_run_is_asked_for_once_a_call_has_shown_the_version_and_only_then(bench: OpcUaBench) -> None:
    nck = bench.control.nck
    bench.clock.move_to(50.0)  # safe points at 80, 120, ...
    await bench.nc.request_probing(1, 50.0)
    assert (await bench.nc.probing_status(1)).state is ProbingState.REQUESTED
    assert (nck.r[R_VERSION], nck.r[R_REQUEST]) == (0.0, 0.0)
    nck.r[R_VERSION] = -1.0  # another gateway's, of a dry run that no call has seen
    assert (await bench.nc.probing_status(1)).state is ProbingState.REQUESTED
    assert nck.r[R_REQUEST] == 0.0
    bench.clock.move_to(81.0)
    assert (await bench.nc.probing_status(1)).state is ProbingState.REQUESTED
    assert (nck.r[R_VERSION], nck.r[R_DRY_RUN], nck.r[R_REQUEST]) == (-1.0, 50.0, 1.0), "a dry run, whatever R63 says"
    bench.clock.move_to(121.0)
    assert (await bench.nc.probing_status(1)).state is ProbingState.ACCEPTED
    bench.clock.move_to(330.0)
    assert (await bench.nc.probing_status(1)).state is ProbingState.DONE
    nck.version, nck.r[R_VERSION] = 0, 0.0
    with pytest.raises(Refused, match="R89"):
        await bench.nc.probing_status(1)  # it was another program that ran


async def test_a_dry_run_that_no_call_has_seen_does_not_stand_in_the_way_of_a_measurement(bench: OpcUaBench) -> None:
    nck = bench.control.nck
    nck.version, nck.r[R_VERSION] = 0, -1.0  # what an earlier run left, and withdrew
    await bench.nc.request_probing(2)
    assert (nck.r[R_VERSION], nck.r[R_DRY_RUN], nck.r[R_REQUEST]) == (0.0, 0.0, 2.0)


async def test_a_dry_run_that_waits_for_the_version_displaces_no_request_of_another_gateway(bench: OpcUaBench) -> None:
    nck = bench.control.nck
    bench.clock.move_to(50.0)
    await bench.nc.request_probing(1, 50.0)
    nck.cycle.next_safe_point = lambda _: math.inf
    nck.write_r(R_REQUEST, 55.0, 60.0)
    nck.r[R_VERSION] = 2.0
    with pytest.raises(Refused, match="request 55 waits"):
        await bench.nc.probing_status(1)
    assert (nck.r[R_REQUEST], nck.r[R_DRY_RUN]) == (55.0, 0.0)


async def test_at_power_on_the_version_is_not_known_until_the_next_safe_point(bench: OpcUaBench) -> None:
    nck = bench.control.nck
    nck.power_on(50.0)
    assert nck.r[R_VERSION] == 0.0
    nck.advance(81.0)
    assert nck.r[R_VERSION] == 2.0


async def test_whether_it_knows_dry_runs_is_what_each_snapshot_shows(bench: OpcUaBench) -> None:
    """And not what was there at `connect`, which the power may have been switched off and on since."""
    nck, shown = bench.control.nck, list[bool | None]()
    assert isinstance(bench.nc, RunsDry)
    for version in (2.0, 0.0, 1.0, math.nan, -1.0, 2.0):
        nck.version, nck.r[R_VERSION] = 0, version
        await bench.nc.snapshot()
        shown.append(bench.nc.runs_dry)
    assert shown == [True, None, False, None, None, True]


async def test_a_height_that_another_program_changes_makes_no_measurement_and_no_dry_run(
    bench: OpcUaBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    nck = bench.control.nck
    nck.r[R_DRY_RUN] = 60.0  # left behind
    await bench.nc.request_probing(1)
    assert nck.r[R_DRY_RUN] == 0.0
    nck.r[R_DRY_RUN] = 60.0
    bench.clock.move_to(bench.clock.now + 200.0)
    with pytest.raises(BadAnswer, match="R63"):
        await bench.nc.probing_status(1)
    kept = nck.write_r
    monkeypatch.setattr(nck, "write_r", lambda number, *told: None if number == R_DRY_RUN else kept(number, *told))
    with pytest.raises(BadAnswer, match="R63"):
        await bench.nc.request_probing(2)
    assert nck.r[R_REQUEST] == 1.0  # nothing was asked


async def test_refused_when_the_probe_is_missing(bench: OpcUaBench) -> None:
    bench.control.nck.set_probe_available(False, bench.clock.now)
    status = await bench.cycle(1)
    assert status.state is ProbingState.REFUSED
    assert status.reason == "another tool than the touch probe is in the spindle"


async def test_refused_when_the_operator_has_taken_over_while_it_waited(bench: OpcUaBench) -> None:
    bench.clock.move_to(50.0)
    await bench.nc.request_probing(1)
    bench.control.nck.set_mode(JOG, bench.clock.now)
    status = await bench.nc.probing_status(1)
    assert (status.state, status.reason) == (ProbingState.REFUSED, "the control is not in AUTO")
    assert (await bench.nc.snapshot()).mode is OperatingMode.JOG


async def test_failed_when_a_touch_finds_nothing(bench: OpcUaBench) -> None:
    bench.control.nck.sphere_present = False
    status = await bench.cycle(1)
    assert status.state is ProbingState.FAILED
    assert status.centres_mm is None
    assert "no sphere" in status.reason


async def test_failed_when_an_alarm_stops_the_cycle(bench: OpcUaBench) -> None:
    await bench.nc.request_probing(1)
    bench.clock.move_to(60.0)
    assert (await bench.nc.probing_status(1)).state is ProbingState.RUNNING
    bench.control.nck.raise_alarm(3000, bench.clock.now)
    bench.clock.move_to(300.0)
    status = await bench.nc.probing_status(1)
    assert (status.state, status.reason) == (ProbingState.FAILED, "an alarm is active")


@pytest.mark.parametrize(("wait_s", "state"), [(20.0, ProbingState.REFUSED), (90.0, ProbingState.FAILED)])
async def test_withdrawn_before_and_during_the_cycle(bench: OpcUaBench, wait_s: float, state: ProbingState) -> None:
    bench.clock.move_to(10.0)
    await bench.nc.request_probing(1)
    bench.clock.move_to(wait_s)
    await bench.nc.withdraw_probing(1)
    if state is ProbingState.REFUSED:
        assert (await bench.nc.probing_status(1)).state is ProbingState.REQUESTED, "a control looks at its safe point"
        bench.clock.move_to(81.0)
    status = await bench.nc.probing_status(1)
    assert (status.state, status.reason) == (state, "withdrawn")
    bench.clock.move_to(400.0)
    assert (await bench.nc.probing_status(1)).state is state
    assert (await bench.cycle(2)).state is ProbingState.DONE


async def test_withdrawing_an_old_request_leaves_another_that_is_withdrawn_alone(bench: OpcUaBench) -> None:
    """R61 holds one number: another gateway's request, or one from before power off, would count again."""
    nck = bench.control.nck
    nck.r[R_REQUEST], nck.r[R_WITHDRAW] = 55.0, 55.0
    await bench.nc.withdraw_probing(1)
    assert nck.r[R_WITHDRAW] == 55.0
    await bench.nc.request_probing(2)  # in its place
    await bench.nc.withdraw_probing(2)
    assert nck.r[R_WITHDRAW] == 2.0


@pytest.mark.parametrize(("state", "withdrawn"), [(CycleState.RUNNING, 1.0), (CycleState.DONE, 55.0)])
async def test_a_cycle_that_runs_is_stopped_whatever_else_is_withdrawn(
    bench: OpcUaBench, state: CycleState, withdrawn: float
) -> None:
    nck = bench.control.nck
    nck.cycle.answer = CycleAnswer(1, state)
    nck.r[R_REQUEST], nck.r[R_WITHDRAW] = 55.0, 55.0
    await bench.nc.withdraw_probing(1)
    assert nck.r[R_WITHDRAW] == withdrawn


async def test_compensation_is_read_back_and_moves_what_the_probe_finds(bench: OpcUaBench) -> None:
    assert await bench.nc.read_compensation() == (0.0, 0.0, 0.0)
    before = await bench.cycle(1)
    await bench.nc.write_compensation((12.5, -7.25, 3.0))
    assert await bench.nc.read_compensation() == pytest.approx((12.5, -7.25, 3.0))
    after = await bench.cycle(2)
    assert before.centres_mm is not None
    assert after.centres_mm is not None
    found = (np.array(after.centres_mm) - np.array(before.centres_mm)) * 1e3
    np.testing.assert_allclose(found, np.tile([-12.5, 7.25, -3.0], (6, 1)), atol=1e-6)


async def test_compensating_the_deviation_makes_it_disappear(bench: OpcUaBench) -> None:
    reference = await bench.cycle(1)
    bench.plant.errors = {"EX0C": 15.0, "EZ0A": -6.0}
    await bench.nc.write_compensation((15.0, 0.0, -6.0))
    compensated = await bench.cycle(2)
    assert reference.centres_mm is not None
    assert compensated.centres_mm is not None
    np.testing.assert_allclose(compensated.centres_mm, reference.centres_mm, atol=1e-9)


async def test_a_control_that_is_not_there() -> None:
    nc = Sinumerik(SinumerikSettings(security="none", url="opc.tcp://127.0.0.1:1", device="mill"), ManualClock())
    with pytest.raises(
        ConnectError, match=r"device mill: cannot open opc\.tcp://127\.0\.0\.1:1: Connection refused \("
    ):
        await nc.connect()
    with pytest.raises(ConnectError, match="connect first"):
        await nc.snapshot()
    await nc.close()


async def test_a_control_that_goes_away_and_comes_back(bench: OpcUaBench) -> None:
    await bench.nc.snapshot()
    await bench.control.stop()
    with pytest.raises(DriverError):
        await bench.nc.snapshot()
    with pytest.raises(ConnectError):
        await bench.nc.connect()
    await bench.control.start()
    await bench.nc.connect()
    await bench.nc.snapshot()


ALL = frozenset(AccessRight)


@pytest.mark.parametrize(
    ("rights", "verb", "missing"),
    [
        (ALL - {AccessRight.SEA_WRITE}, "write_compensation", "SeaWrite"),
        (ALL - {AccessRight.STATE_WRITE}, "request_probing", "StateWrite"),
        (ALL - {AccessRight.STATE_WRITE}, "withdraw_probing", "StateWrite"),
    ],
)
async def test_a_missing_right_is_named(
    tmp_path: Path, rights: frozenset[AccessRight], verb: str, missing: str
) -> None:
    password = tmp_path / "password"
    password.write_text("secret\n")
    async with sinumerik_bench({"gateway": User("secret", rights)}) as bench:
        settings = SinumerikSettings(security="none", url=bench.url, user="gateway", password_file=password)
        nc = Sinumerik(settings, bench.clock)
        await nc.connect()
        argument = (1.0, 2.0, 3.0) if verb == "write_compensation" else 7
        with pytest.raises(Refused, match=f"'gateway' the right {missing}"):
            await getattr(nc, verb)(argument)
        assert await nc.read_compensation() == (0.0, 0.0, 0.0)
        await nc.close()


async def test_a_wrong_password_and_no_user_are_refused(tmp_path: Path) -> None:
    password = tmp_path / "password"
    password.write_text("guess")
    async with sinumerik_bench({"gateway": User("secret")}) as bench:
        wrong = Sinumerik(
            SinumerikSettings(security="none", url=bench.url, user="gateway", password_file=password), bench.clock
        )
        with pytest.raises(Refused, match="refuses user 'gateway'"):
            await wrong.connect()
        with pytest.raises(Refused, match="anonymous"):
            await bench.nc.connect()


async def test_a_request_that_finds_no_safe_point_in_its_time_is_refused_and_never_begun(bench: OpcUaBench) -> None:
    hurried = wired(SinumerikSettings(security="none", url=bench.url)).model_copy(
        update={"handshake": Handshake(request_valid_for_s=20.0)}
    )
    nc = Sinumerik(hurried, bench.clock)
    await nc.connect()
    bench.clock.move_to(50.0)  # safe points at 80, 120, ...
    await nc.request_probing(5)
    bench.clock.move_to(69.0)
    assert (await nc.probing_status(5)).state is ProbingState.REQUESTED
    bench.clock.move_to(200.0)
    status = await nc.probing_status(5)
    assert (status.state, status.reason) == (ProbingState.REFUSED, "no safe point before the request expired")
    assert bench.plant.asked_at_s == []
    await nc.close()


@pytest.mark.parametrize("value", [math.nan, math.inf])
async def test_a_position_or_an_offset_that_is_not_a_number_is_an_invalid_answer_and_names_its_node(
    bench: OpcUaBench, value: float
) -> None:
    state = bench.control.state
    bench.control.state = lambda: replace(state(), positions=state().positions | {"Y": value})  # type: ignore[method-assign]
    with pytest.raises(BadAnswer, match=r"actToolBasePos\[u1,2\] = (nan|inf): not a finite number"):
        await bench.nc.snapshot()
    bench.control.state = state  # type: ignore[method-assign]
    bench.control.nck.k0_mm[2] = value
    with pytest.raises(BadAnswer, match=r"TEMP_COMP_ABS_VALUE\[u3\] = (nan|inf): not a finite number"):
        await bench.nc.read_compensation()


async def test_a_state_or_a_tool_that_is_not_a_number_counts_as_not_reported(bench: OpcUaBench) -> None:
    state = bench.control.state
    spoiled = replace(state(), tool=math.nan, probing=math.nan, loads=replace(state().loads, spindle=math.nan))  # type: ignore[arg-type]
    bench.control.state = lambda: spoiled  # type: ignore[method-assign]
    snapshot = await bench.nc.snapshot()
    assert (snapshot.tool, snapshot.probe_in_spindle) == (None, None)
    assert "spindle_speed" not in snapshot.states
    assert "speed_X" in snapshot.states
    bench.control.state = lambda: replace(state(), alarms=(math.nan,))  # type: ignore[method-assign, arg-type]
    assert len((await bench.nc.snapshot()).alarms) == 1, "something is shown"


@pytest.mark.parametrize(("value", "ready"), [(3.0, True), (2.0, False), (math.nan, False)])
async def test_an_axis_is_referenced_only_when_the_control_says_so(
    bench: OpcUaBench, value: float, ready: bool
) -> None:
    plain = SinumerikSettings(security="none", url=bench.url)
    settings = plain.model_copy(
        update={"nodes": plain.nodes.model_copy(update={"referenced": "/Channel/Parameter/R[u1,{n}]"})}
    )
    bench.control.nck.r[1:4] = [3.0, value, 3.0]
    nc = Sinumerik(settings, bench.clock)
    await nc.connect()
    assert (await nc.snapshot()).ready is ready
    await nc.close()


@pytest.mark.parametrize(
    ("alarms", "ready"),
    [
        ((), True),
        ((21612,) * (ALARMS_SHOWN - 1), True),
        ((*((21612,) * 7), 3000), False),
        ((21612,) * ALARMS_SHOWN, False),  # what comes after these is not shown
        ((math.nan,), True),
    ],
)
async def test_a_control_is_ready_that_shows_no_emergency_stop_and_has_room_to_show_one(
    bench: OpcUaBench, alarms: tuple[int, ...], ready: bool
) -> None:
    bench.control.nck.alarms = alarms
    assert (await bench.nc.snapshot()).ready is ready


async def test_drives_that_are_off_are_not_ready_where_the_control_has_a_bit_for_it(bench: OpcUaBench) -> None:
    plain = SinumerikSettings(security="none", url=bench.url)
    nc = Sinumerik(
        plain.model_copy(update={"nodes": plain.nodes.model_copy(update={"drives_on": DRIVES_ON})}), bench.clock
    )
    await nc.connect()
    assert (await nc.snapshot()).ready is True
    bench.control.nck.drives_on = False
    assert (await nc.snapshot()).ready is False
    assert (await bench.nc.snapshot()).ready is True, "not configured, not read"
    await nc.close()


async def test_without_alarm_nodes_none_are_read(bench: OpcUaBench) -> None:
    plain = SinumerikSettings(security="none", url=bench.url)
    nc = Sinumerik(plain.model_copy(update={"nodes": plain.nodes.model_copy(update={"alarms": ()})}), bench.clock)
    await nc.connect()
    bench.control.nck.raise_alarm(21612, bench.clock.now)
    snapshot = await nc.snapshot()
    assert (snapshot.alarms, snapshot.ready) == ((), True)
    await nc.close()


async def test_scatter_of_repeated_touches_is_reported_with_the_result(bench: OpcUaBench) -> None:
    assert (await bench.cycle(1)).spread_mm == 0.0
    bench.control.nck.loose_um = 20.0
    bench.clock.move_to(bench.clock.now + 10.0)
    loose = (await bench.cycle(2)).spread_mm
    assert loose == bench.control.nck.r[R_SPREAD] > 0.01
