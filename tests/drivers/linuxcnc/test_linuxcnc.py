"""The driver against the real LinuxCNC with the agent of deploy/nc/linuxcnc. Needs Debian's linuxcnc-uspace."""

import socket
import time
from collections.abc import AsyncIterator
from contextlib import suppress
from pathlib import Path

import pytest
import pytest_asyncio

from drivers.agent.control import AgentControl
from drivers.base import ConnectError, Refused, SetupError, SystemClock
from drivers.linuxcnc.settings import LinuxCncSettings
from drivers.nc import OperatingMode, ProgramState, WatchdogTerms
from tests.benches.linuxcnc_bench import AgentBench, claimed, refusal, running, until

pytestmark = [pytest.mark.peer, pytest.mark.asyncio(loop_scope="module")]


@pytest_asyncio.fixture(scope="module", loop_scope="module", autouse=True)
async def loop() -> None:
    """Begins the module's event loop: not within a test, where its sockets would look left open."""


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def started(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[AgentBench]:
    """One LinuxCNC for all tests that leave it as it was: a start takes longer than most of them."""
    async with running(tmp_path_factory.mktemp("linuxcnc"), {"SLEW": 1.0}) as it:
        await it.nc.close()
        yield it


@pytest_asyncio.fixture(loop_scope="module")
async def bench(started: AgentBench) -> AsyncIterator[AgentBench]:
    """Switched on and homed; nobody owns the compensation, and nothing is in force."""
    bench = AgentBench(started.operator, AgentControl(started.settings, SystemClock()), started.settings)
    await bench.nc.connect()
    yield bench

    async def connected() -> bool:
        """Again, after a test that closed it; a control that was frozen may still stand."""
        with suppress(Refused):
            await bench.nc.connect()
            return True
        return False

    await until(connected)
    await bench.nc.claim(7, WatchdogTerms(60.0, 1000.0), predecessor=8)
    await bench.nc.release(7)

    async def gone() -> bool:
        return await bench.nc.read_compensation() == (0.0, 0.0, 0.0)

    await until(gone)
    await bench.nc.close()
    if not await bench.operator.sees(on=True):
        await bench.operator.ask("switch_on")
    for block in ("M5 M9 G49", "T0 M6", "G53 G0 X0 Y0 Z0 A0 C0"):
        await bench.operator.ask("mdi", block)


async def test_snapshot_shows_what_the_control_does(bench: AgentBench) -> None:
    await bench.operator.ask("mdi", "G53 G0 X5 A-45 C90")
    at_rest = await bench.nc.snapshot()
    assert at_rest.positions == pytest.approx({"X": 5, "Y": 0, "Z": 0, "A": -45, "C": 90}, abs=1e-6)
    assert (at_rest.mode, at_rest.program, at_rest.alarms) == (OperatingMode.MDA, ProgramState.STOPPED, ())
    assert (at_rest.tool, at_rest.probe_in_spindle) == (0, False)
    await bench.operator.ask("mdi", "T99 M6 G43 M3 S1200 M8")
    await bench.operator.ask("mdi", "M68 E0 Q3.5")
    turning = await bench.nc.snapshot()
    assert turning.tool == 99
    assert turning.probe_in_spindle
    assert (turning.states["spindle_speed"], turning.states["coolant"]) == (1200.0, 1.0)
    assert (turning.states["analog_output_0"], turning.states["analog_output_3"]) == (3.5, 0.0), "a stated tolerance"
    await bench.operator.ask("estop")
    assert (await bench.nc.snapshot()).alarms == (1,)


@pytest.mark.realtime
async def test_speeds_are_the_mean_since_the_last_question(bench: AgentBench) -> None:
    """Whatever the feed was at this moment: 60 mm and one turn. Tolerance: 2 %, and that the agent took each of its two
    times somewhere between question and answer."""
    asked = time.monotonic()
    await bench.nc.snapshot()
    answered = time.monotonic()
    await bench.operator.ask("mdi", "G53 G1 X60 C360 F3000")
    asked_again = time.monotonic()
    turned = await bench.nc.snapshot()
    least_min, most_min = (asked_again - answered) / 60.0, (time.monotonic() - asked) / 60.0
    assert 0.98 * 60.0 / most_min < turned.states["speed_X"] < 1.02 * 60.0 / least_min
    assert 0.98 * 1.0 / most_min < turned.states["speed_C"] < 1.02 * 1.0 / least_min
    assert turned.states["speed_Y"] == 0.0


@pytest.mark.realtime
@pytest.mark.parametrize("part", ["rtapi_app"])
async def test_a_control_whose_values_stand_still_is_not_trusted(part: str, bench: AgentBench) -> None:
    """After 2 s. Tolerance: half a second before, for what was still moving; later without a limit."""

    async def refused() -> bool:
        try:
            await bench.nc.snapshot()
        except Refused as error:
            return error.reason == "stale"
        return False

    assert not await refused()
    began = time.monotonic()
    await bench.operator.ask("freeze", part)
    await until(refused)
    assert time.monotonic() - began > 1.5
    await bench.operator.ask("thaw", part)

    async def believed() -> bool:
        return not await refused()

    await until(believed)


async def test_offsets_are_read_back_from_where_they_act(bench: AgentBench) -> None:
    with refusal("no_heartbeat"):
        await bench.nc.write_compensation((1.0, 0.0, 0.0))
    await claimed(bench, WatchdogTerms(60.0, 1.0))
    await bench.nc.write_compensation((3.0, -2.0, 0.5))
    assert await bench.nc.read_compensation() == pytest.approx((3.0, -2.0, 0.5), abs=1e-3)
    assert await bench.pin("y-drive") == pytest.approx(-0.002, abs=1e-6)
    with refusal("bound"):
        await bench.nc.write_compensation((0.0, 0.0, 250.0))
    with pytest.raises(ValueError, match="largest_um"):
        await bench.nc.write_compensation((0.0, 0.0, 501.0))
    assert await bench.nc.read_compensation() == pytest.approx((3.0, -2.0, 0.5), abs=1e-3)


@pytest.mark.realtime
async def test_silence_holds_the_offsets_then_takes_them_to_zero_and_a_beat_ends_the_ramp(bench: AgentBench) -> None:
    """Tolerance: the ramp begins at most 0.1 s before 1 s of silence, and ends within 0.3 s of when it should."""
    await claimed(bench, WatchdogTerms(60.0, 20.0))
    await bench.nc.write_compensation((40.0, -10.0, 0.0))

    async def written() -> bool:
        return await bench.pin("talc-x-in-force") == pytest.approx(0.040, abs=1e-9)

    async with bench.beating(7):
        await until(written)
    last_beat = time.monotonic()
    await bench.nc.claim(7, WatchdogTerms(1.0, 20.0))

    async def begun() -> bool:
        return await bench.pin("talc-x-in-force") < 0.0399

    await until(begun)
    assert time.monotonic() - last_beat > 0.9  # held until then
    assert await bench.nc.heartbeat(7) is False
    there = await bench.nc.read_compensation()
    assert 0 < there[0] < 40.0
    assert there[1] > -10.0
    async with bench.beating(7):
        await bench.pass_time(0.2)  # a ramp would take 4 µm
        assert await bench.nc.read_compensation() == pytest.approx(there, abs=0.2)
    began, from_um = time.monotonic(), there[0]

    async def gone() -> bool:
        return await bench.nc.read_compensation() == (0.0, 0.0, 0.0)

    await until(gone)
    assert time.monotonic() - began == pytest.approx(1.0 + from_um / 20.0, abs=0.3)  # s: LinuxCNC's own real time


@pytest.mark.realtime
async def test_the_offsets_go_to_zero_although_the_agent_was_killed_and_sends_no_heartbeat(tmp_path: Path) -> None:
    """Tolerance: 0.1 s before silence and ramp are over, and 1 s after, for what a busy computer takes."""
    async with running(tmp_path, {"SLEW": 1.0}) as bench:
        await claimed(bench, WatchdogTerms(60.0, 10.0))
        await bench.nc.write_compensation((5.0, 0.0, 0.0))

        async def written() -> bool:
            return await bench.pin("talc-x-in-force") == pytest.approx(0.005, abs=1e-9)

        async with bench.beating(7):
            await until(written)
        last_beat = time.monotonic()
        await bench.nc.claim(7, WatchdogTerms(0.5, 10.0))
        await bench.operator.ask("kill_agent")
        killed = time.monotonic()
        with pytest.raises(ConnectError):
            await bench.nc.read_compensation()

        async def gone() -> bool:
            return await bench.pin("talc-x-in-force") == 0.0

        await until(gone)
        now = time.monotonic()
        assert now - last_beat >= 0.4 + 0.5
        assert now - killed <= 0.5 + 0.5 + 1.0
        assert (await bench.operator.ask("state"))["on"]  # the machine itself goes on


async def test_silence_moves_the_offsets_no_faster_than_the_control_allows_whatever_was_claimed(tmp_path: Path) -> None:
    async with running(tmp_path, {"SLEW": 0.01}) as bench:
        await claimed(bench, WatchdogTerms(60.0, 1000.0))
        await bench.nc.write_compensation((6.0, 0.0, 0.0))
        assert (await bench.nc.read_compensation())[0] == pytest.approx(6.0, abs=1e-3)
        before_s = await bench.time_s()
        await bench.nc.release(7)

        async def gone() -> bool:
            return await bench.nc.read_compensation() == (0.0, 0.0, 0.0)

        await until(gone)
        assert await bench.time_s() - before_s >= 6.0 / 10.0 * 0.99


async def impatient(bench: AgentBench) -> AgentControl:
    """A driver in place of the bench's: waits no longer than 20 s until an offset is in force."""
    await bench.nc.close()
    bench.nc = AgentControl(bench.settings.model_copy(update={"timeout_s": 20.0}), SystemClock())
    await bench.nc.connect()
    return bench.nc


async def test_a_claim_counts_before_the_real_time_thread_has_seen_it(bench: AgentBench) -> None:
    """On a busy computer this takes a while; meanwhile nobody else may claim, and the owner may write."""
    nc = await impatient(bench)
    await bench.operator.ask("freeze", "rtapi_app")
    await nc.claim(7, WatchdogTerms(600.0, 1.0))
    with refusal("owner"):
        await nc.claim(8, WatchdogTerms(600.0, 1.0))
    await nc.write_compensation((3.0, -2.0, 0.5))
    assert await nc.heartbeat(7)
    assert await nc.read_compensation() == (0.0, 0.0, 0.0)
    await bench.operator.ask("thaw", "rtapi_app")

    async def in_force() -> bool:
        return await nc.read_compensation() == pytest.approx((3.0, -2.0, 0.5), abs=1e-3)

    await until(in_force)


async def test_a_claim_after_a_release_that_the_real_time_thread_has_not_seen_holds_what_is_in_force(
    tmp_path: Path,
) -> None:
    async with running(tmp_path, {"SLEW": 0.001}) as bench:
        await claimed(bench, WatchdogTerms(600.0, 1.0))
        nc = await impatient(bench)
        await nc.claim(7, WatchdogTerms(600.0, 1.0))
        await nc.write_compensation((150.0, 0.0, 0.0))  # on its way when the time is over
        await bench.operator.ask("freeze", "rtapi_app")
        there = await nc.read_compensation()
        assert 1.0 < there[0] < 149.0
        await nc.release(7)
        await nc.claim(8, WatchdogTerms(600.0, 1.0))
        await bench.operator.ask("thaw", "rtapi_app")
        await bench.pass_time(2.0)
        assert await nc.read_compensation() == pytest.approx(there, abs=1e-3)


async def test_what_an_earlier_claim_wanted_never_comes_back_in_whatever_order_real_time_sees_a_new_one(
    tmp_path: Path,
) -> None:
    """As when the agent is interrupted in the middle of a claim: only the silence has become longer."""
    async with running(tmp_path, {"SLEW": 1.0}) as bench:
        await claimed(bench, WatchdogTerms(60.0, 1000.0))
        await bench.nc.write_compensation((2.0, 0.0, -1.0))

        async def in_force() -> float:
            return await bench.pin("talc-x-in-force") * 1e3

        async def written() -> bool:
            return await in_force() == pytest.approx(2.0, abs=1e-6)

        async with bench.beating(7):
            await until(written)
        await bench.nc.claim(7, WatchdogTerms(0.5, 1000.0))

        async def gone() -> bool:
            return await in_force() == 0.0

        await until(gone)
        await bench.operator.ask("hal", "unlinkp", "talc-errors.silence")
        await bench.operator.ask("hal", "setp", "talc-errors.silence", "60")

        async def watching() -> bool:
            return bool(await bench.operator.ask("hal", "getp", "talc-errors.watching") == "TRUE")

        await until(watching)
        await bench.pass_time(0.1)  # at this slew, 100 µm
        assert await in_force() == 0.0
        await claimed(bench, WatchdogTerms(60.0, 1000.0))
        await bench.pass_time(0.1)
        assert await in_force() == 0.0
        await bench.nc.write_compensation((2.0, 0.0, -1.0))
        await until(written)


async def test_a_wrong_key_and_a_closed_port_are_reported(bench: AgentBench, tmp_path: Path) -> None:
    (tmp_path / "other").write_text("x" * 40)
    port = bench.settings.port
    with refusal("key"):
        await AgentControl(LinuxCncSettings(key_file=tmp_path / "other", port=port), SystemClock()).connect()
    (tmp_path / "short").write_text("x")
    with pytest.raises(SetupError, match="at least 32"):
        await AgentControl(LinuxCncSettings(key_file=tmp_path / "short", port=port), SystemClock()).connect()
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))
        settings = LinuxCncSettings(key_file=bench.settings.key_file, port=closed.getsockname()[1])
        with pytest.raises(ConnectError):
            await AgentControl(settings, SystemClock()).connect()
