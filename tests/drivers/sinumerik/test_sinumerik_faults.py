"""Faults between the gateway and a control, and the driver's reaction to them."""

import asyncio
import logging
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from datetime import datetime
from pathlib import Path
from time import monotonic
from typing import TypeVar

import pytest

from drivers.base import BadAnswer, ConnectError, DriverError, NoAnswer, Refused, SystemClock, WrongDevice
from drivers.nc import OperatingMode, ProbingState, WatchdogTerms
from drivers.sinumerik.control import Sinumerik
from drivers.sinumerik.settings import OffsetRoute, Paths, SinumerikSettings, StateNode
from gateway.runtime.clocks import RealClock
from simulators.nc import Activity, DayPart, EmulatedControl, LoadCase, MeanLoads, User
from simulators.nc.nck import R_ANSWERS, R_REQUEST, R_RESULT_OF, R_STATE
from simulators.nc.variables import AccessRight
from tests.benches.cut_wire import wire_to
from tests.benches.emulated_bench import Rigid

pytestmark = pytest.mark.simulated_time


class FrozenProgram(EmulatedControl):
    """A control whose part program never looks at the handshake: what the test writes to R-parameters stays."""

    def now(self) -> float:
        return 0.0


class NextCycle(FrozenProgram):
    """It begins cycle 42 after this many read requests."""

    requests_left: int | None = None
    changes: Mapping[int, float] = {R_ANSWERS: 42.0, R_STATE: 1.0, R_RESULT_OF: 0.0}

    def utc(self) -> datetime:  # every read request stamps its values with the time, once and first
        if self.requests_left == 0:
            for number, value in self.changes.items():
                self.nck.r[number] = value
        if self.requests_left is not None:
            self.requests_left -= 1
        return super().utc()


@asynccontextmanager
async def running(control: EmulatedControl) -> AsyncIterator[str]:
    url = await control.start()
    try:
        yield url
    finally:
        await control.stop()
        await asyncio.get_running_loop().shutdown_default_executor()


C = TypeVar("C", bound=EmulatedControl)


def emulated(users: dict[str, User] | None = None) -> EmulatedControl:
    return of_kind(EmulatedControl, users)


def of_kind(kind: type[C], users: dict[str, User] | None = None) -> C:
    work = MeanLoads(x=60.0)  # 1 mm/s
    return kind(Rigid(), RealClock(), LoadCase([DayPart(0.0, 1e9, Activity.ROUGHING, work)]), users=users)


async def test_a_server_that_accepts_and_says_nothing() -> None:
    hung_up = asyncio.Event()

    async def sink(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.read()
        writer.close()
        await writer.wait_closed()
        hung_up.set()

    server = await asyncio.start_server(sink, "127.0.0.1", 0)
    url = f"opc.tcp://127.0.0.1:{server.sockets[0].getsockname()[1]}"
    nc = Sinumerik(SinumerikSettings(security="none", url=url, timeout_s=0.3), SystemClock())
    began = monotonic()
    with pytest.raises(NoAnswer, match=r"does not answer within 0\.3 s"):
        await nc.connect()
    assert monotonic() - began < 2.0
    async with asyncio.timeout(1.0):
        await hung_up.wait()
    await nc.close()
    server.close()
    await server.wait_closed()


@pytest.mark.parametrize(
    "answer",
    [b"", b"HTTP/1.1 400 Bad Request\r\n\r\n", b"ACKF\x08\x00\x00\x00", b"\x00" * 64, b"MSGF\xff\xff\xff\x7f"],
    ids=["hangs_up", "http", "short_ack", "zeros", "huge"],
)
async def test_something_that_is_not_an_opc_ua_server(answer: bytes) -> None:
    ended = asyncio.Event()

    async def speak(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.read(1)
        writer.write(answer)
        if not answer:
            writer.close()
        await reader.read()
        writer.close()
        ended.set()

    server = await asyncio.start_server(speak, "127.0.0.1", 0)
    url = f"opc.tcp://127.0.0.1:{server.sockets[0].getsockname()[1]}"
    nc = Sinumerik(SinumerikSettings(security="none", url=url, timeout_s=0.3), SystemClock())
    with pytest.raises((ConnectError, NoAnswer), match="OPC UA server"):
        await nc.connect()
    async with asyncio.timeout(1.0):
        await ended.wait()
    server.close()
    await server.wait_closed()


async def test_a_connection_that_goes_silent_in_a_session_and_comes_back() -> None:
    async with running(emulated()) as url, wire_to(url) as (wire, joined):
        nc = Sinumerik(SinumerikSettings(security="none", url=joined, timeout_s=0.3), SystemClock())
        await nc.connect()
        wire.silent = True
        began = monotonic()
        with pytest.raises(NoAnswer):
            await nc.snapshot()
        with pytest.raises(ConnectError, match="connect first"):
            await nc.snapshot()
        assert monotonic() - began < 2.0
        wire.silent = False
        await nc.connect()
        await nc.snapshot()
        await nc.close()


async def test_a_write_without_an_answer_ends_with_a_reset_so_that_it_does_not_arrive_later() -> None:
    async with running(emulated()) as url, wire_to(url) as (wire, joined):
        nc = Sinumerik(SinumerikSettings(security="none", url=joined, timeout_s=0.3), SystemClock())
        await nc.connect()
        wire.silent = True
        with pytest.raises(NoAnswer):
            await nc.write_compensation((1.0, 2.0, 3.0))
        async with asyncio.timeout(60.0):
            while not wire.reset:
                await asyncio.sleep(0.01)
        wire.silent = False
        await nc.connect()
        assert await nc.read_compensation() == (0.0, 0.0, 0.0)
        await nc.close()


@pytest.mark.parametrize(("late_s", "acts"), [(1.0, True), (9.0, False)])
async def test_a_write_that_the_network_holds_for_longer_than_the_session_lasts_is_refused(
    late_s: float, acts: bool
) -> None:
    control = emulated()
    async with running(control) as url, wire_to(url) as (wire, joined):
        nc = Sinumerik(SinumerikSettings(security="none", url=joined, timeout_s=0.3, session_s=3.0), SystemClock())
        await nc.connect()
        assert nc.late_write_s == 3.0
        wire.delay = lambda data: late_s if b"TEMP_COMP_ABS_VALUE" in data else 0.0
        with pytest.raises(NoAnswer):
            await nc.write_compensation((1.0, 2.0, 3.0))
        await asyncio.sleep(12.0)
        assert control.nck.k0_mm == ([-0.001, -0.002, -0.003] if acts else [0.0, 0.0, 0.0])


async def test_a_connection_that_is_cut_in_a_session(caplog: pytest.LogCaptureFixture) -> None:
    async with running(emulated()) as url, wire_to(url) as (wire, joined):
        nc = Sinumerik(SinumerikSettings(security="none", url=joined, timeout_s=0.5), SystemClock())
        await nc.connect()
        await wire.cut()
        with pytest.raises(ConnectError):
            await nc.snapshot()
        ours = [r for r in caplog.records if r.name.startswith("asyncua.client") and r.levelno >= logging.ERROR]
        assert not ours, "a lost connection is reported once, by the driver"
        await nc.connect()
        await nc.snapshot()
        await nc.close()


async def test_connecting_can_be_cancelled_and_leaves_nothing() -> None:
    async with running(emulated()) as url, wire_to(url) as (wire, joined):
        wire.silent = True
        nc = Sinumerik(SinumerikSettings(security="none", url=joined, timeout_s=5.0), SystemClock())
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.2):
                await nc.connect()
        wire.silent = False
        await nc.connect()
        await nc.close()


async def test_what_is_written_is_in_force_after_reconnecting() -> None:
    control = emulated()
    async with running(control) as url:
        nc = Sinumerik(SinumerikSettings(security="none", url=url), SystemClock())
        await nc.connect()
        await nc.write_compensation((4.0, 5.0, 6.0))
        await nc.request_probing(8)
        await control.stop()
        with pytest.raises(DriverError):
            await nc.read_compensation()
        await control.start()
        await nc.connect()
        assert await nc.read_compensation() == pytest.approx((4.0, 5.0, 6.0))
        assert (await nc.probing_status(8)).state is not ProbingState.IDLE
        await nc.close()


async def test_a_server_that_is_not_a_sinumerik() -> None:
    async with running(emulated()) as url:
        nc = Sinumerik(SinumerikSettings(security="none", url=url, namespace_uri="urn:some:lathe"), SystemClock())
        with pytest.raises(WrongDevice, match=r"no namespace 'urn:some:lathe' \(it has .*SinumerikVarProvider"):
            await nc.connect()


async def test_a_path_that_does_not_exist_is_named_when_connecting() -> None:
    async with running(emulated()) as url:
        wrong_state = SinumerikSettings(security="none", url=url, states={"coolant": StateNode(path="/Plc/Q77.7")})
        wrong_axis = SinumerikSettings(
            security="none", url=url, nodes=Paths(position="/Channel/machineAxis/pos[u1,{n}]")
        )
        for settings, path in ((wrong_state, r"/Plc/Q77\.7"), (wrong_axis, r"machineAxis/pos\[u1,1\]")):
            with pytest.raises(WrongDevice, match=f"{path} does not exist"):
                await Sinumerik(settings, SystemClock()).connect()


@pytest.mark.parametrize(
    "right", [AccessRight.STATE_READ, AccessRight.SEA_READ, AccessRight.PLC_READ, AccessRight.TEA_READ]
)
async def test_a_missing_right_to_read_is_named_when_connecting(tmp_path: Path, right: AccessRight) -> None:
    password = tmp_path / "password"
    password.write_text("secret")
    async with running(emulated({"watcher": User("secret", frozenset(AccessRight) - {right})})) as url:
        settings = SinumerikSettings(
            security="none",
            url=url,
            user="watcher",
            password_file=password,
            states={"coolant": StateNode(path="/Plc/M120.0")},
        )
        nc = Sinumerik(settings, SystemClock())
        with pytest.raises(Refused, match=f"'watcher' the right {right.value}"):
            await nc.connect()
        await nc.close()


@pytest.mark.parametrize("right", [AccessRight.STATE_WRITE, AccessRight.SEA_WRITE])
async def test_whether_it_may_write_can_be_tried_and_a_missing_right_is_named(
    tmp_path: Path, right: AccessRight
) -> None:
    password = tmp_path / "password"
    password.write_text("secret")
    user = User("secret", frozenset(AccessRight) - {right})
    control = emulated({"watcher": user, "gateway": User("secret")})
    async with running(control) as url:
        plain = SinumerikSettings(security="none", url=url, user="gateway", password_file=password)
        control.nck.k0_mm[:] = [0.001, 0.002, -0.003]
        nc = Sinumerik(plain, SystemClock())
        await nc.connect()
        before = (list(control.nck.r), list(control.nck.k0_mm))
        await nc.try_writing()
        assert (control.nck.r, control.nck.k0_mm) == before, "and nothing has changed"
        await nc.claim(7, WatchdogTerms(60.0, 1.0))
        watcher = Sinumerik(plain.model_copy(update={"user": "watcher"}), SystemClock())
        await watcher.connect()
        with pytest.raises(Refused, match="gateway 7 holds the control: writing was not tried"):
            await watcher.try_writing()
        await nc.release(7)
        await nc.close()
        with pytest.raises(Refused, match=f"'watcher' the right {right.value}"):
            await watcher.try_writing()
        await watcher.close()


async def test_done_without_the_results_of_this_request_is_an_invalid_answer() -> None:
    control = of_kind(FrozenProgram)
    async with running(control) as url:
        nc = Sinumerik(SinumerikSettings(security="none", url=url), SystemClock())
        await nc.connect()
        r = control.nck.r
        r[R_REQUEST], r[R_ANSWERS], r[R_STATE], r[R_RESULT_OF] = 7.0, 7.0, 3.0, 6.0
        with pytest.raises(BadAnswer, match="results belong to cycle 6"):
            await nc.probing_status(7)
        r[R_STATE] = 11.0
        with pytest.raises(BadAnswer, match="probing state 11"):
            await nc.probing_status(7)
        await nc.close()


async def test_a_slope_that_somebody_set_shows_in_what_is_in_force() -> None:
    control = of_kind(FrozenProgram)
    async with running(control) as url:
        nc = Sinumerik(SinumerikSettings(security="none", url=url), SystemClock())
        await nc.connect()
        await nc.write_compensation((10.0, 0.0, 0.0))
        control.nck.slope[2], control.nck.reference_mm[2] = 20e-6, 100.0  # Z stands at 150 mm
        assert await nc.read_compensation() == pytest.approx((10.0, 0.0, -1.0))
        assert control.nck.shift_um((0.0, 0.0, 150.0)) == pytest.approx((10.0, 0.0, -1.0))
        await nc.close()


@pytest.mark.parametrize("route", ["k0", "r"])
@pytest.mark.parametrize("machine_sign", [-1, 1])
async def test_the_tool_moves_the_way_it_was_asked_to(route: str, machine_sign: int) -> None:
    work = LoadCase([DayPart(0.0, 1e9, Activity.PAUSE, MeanLoads())])
    control = EmulatedControl(Rigid(), RealClock(), work, compensation_sign=machine_sign)
    async with running(control) as url:
        signs = (machine_sign,) * 3 if route == "k0" else None
        compensation = OffsetRoute(route="r" if route == "r" else "k0", signs=signs)
        nc = Sinumerik(SinumerikSettings(security="none", url=url, compensation=compensation), SystemClock())
        await nc.connect()
        await nc.write_compensation((10.0, -20.0, 30.0))
        assert control.nck.shift_um((0.0, 0.0, 0.0)) == pytest.approx((10.0, -20.0, 30.0))
        assert await nc.read_compensation() == pytest.approx((10.0, -20.0, 30.0))
        await nc.close()


@pytest.mark.parametrize(
    ("state", "changes"),
    [*((state, NextCycle.changes) for state in (3.0, 4.0, 5.0)), (3.0, {R_STATE: 5.0}), (5.0, {R_STATE: 3.0})],
)
async def test_an_answer_that_changes_between_two_looks_is_not_used_yet(
    state: float, changes: Mapping[int, float]
) -> None:
    control = of_kind(NextCycle)
    control.changes = changes
    async with running(control) as url:
        nc = Sinumerik(SinumerikSettings(security="none", url=url), SystemClock())
        await nc.connect()
        r = control.nck.r
        r[R_REQUEST] = r[R_ANSWERS] = r[R_RESULT_OF] = 41.0
        r[R_STATE] = state
        control.requests_left = 1
        assert (await nc.probing_status(41)).state is ProbingState.REQUESTED
        assert control.requests_left == -1, "it looked twice"
        await nc.close()


@pytest.mark.parametrize("what", ["a position", "a state", "the mode", "an alarm", "a result"])
async def test_a_value_that_the_control_itself_calls_bad_is_not_used(what: str) -> None:
    control = of_kind(FrozenProgram)
    async with running(control) as url:
        nc = Sinumerik(SinumerikSettings(security="none", url=url), SystemClock())
        await nc.connect()
        good = await nc.snapshot()
        assert (good.ready, good.mode) == (True, OperatingMode.AUTO)
        if what == "a position":
            control.out_of_service.add("/Channel/MachineAxis/actToolBasePos[u1,2]")
            with pytest.raises(BadAnswer, match=r"actToolBasePos\[u1,2\] has no value"):
                await nc.snapshot()
        elif what == "a state":
            control.out_of_service.add("/Channel/Spindle/actSpeed[u1,1]")
            assert set(good.states) - set((await nc.snapshot()).states) == {"spindle_speed"}
        elif what == "the mode":
            control.out_of_service.add("/Bag/State/opMode[u1]")
            assert (await nc.snapshot()).mode is OperatingMode.UNKNOWN
        elif what == "an alarm":
            control.out_of_service.add("/Nck/SequencedAlarms/textIndex[2]")
            assert (await nc.snapshot()).ready is False, "it may be the emergency stop"
        else:
            r = control.nck.r
            r[R_REQUEST] = r[R_ANSWERS] = r[R_RESULT_OF] = 41.0
            r[R_STATE] = 3.0
            assert (await nc.probing_status(41)).state is ProbingState.DONE
            control.out_of_service.add("/Channel/Parameter/R[u1,75]")
            with pytest.raises(BadAnswer, match=r"R\[u1,75\] has no value"):
                await nc.probing_status(41)
        await nc.close()
