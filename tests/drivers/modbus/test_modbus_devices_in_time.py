"""Modbus devices that want to be asked in their own time: each is read within 20 periods, at several periods."""

import asyncio
import struct
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.base import Quality, Reading, SystemClock
from drivers.build import make_device
from gateway.acquisition.acquisition import Acquisition
from gateway.acquisition.line import Line
from gateway.acquisition.once import read_once
from gateway.model.notice import Notice
from gateway.runtime.clocks import RealClock
from tests.benches.buses import make_bus
from tests.benches.rtu_talk import honest, line
from tests.benches.stream_server import stream_server

pytestmark = pytest.mark.simulated_time

PERIODS, WITHIN, TIMEOUT_S = 40, 20, 0.3
PROFILE = """
protocol = "modbus"
title = "two blocks"
buses = ["modbus_rtu", "modbus_tcp"]
unit = "1"
[[block]]
function = 4
address = 0
channels = 2
type = "uint16"
[[block]]
function = 4
address = 200
channels = 2
type = "uint16"
"""
HELD = [100.0, 101.0, 300.0, 301.0]
"""Register n holds 100 + n."""
_HEAD = struct.Struct(">HHHBBHH")


class Host:
    """A Modbus TCP server. Times are seconds."""

    mute_s = 0.0
    """How long after a connection it swallows requests."""
    rest_s = 0.0
    """How soon after an answer it answers exception 11."""
    behind = 0
    """So many of its first connections give each request the answer to the one before."""
    step = 0
    """What it adds to a request's number."""
    connections = 0

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        loop = asyncio.get_running_loop()
        self.connections += 1
        slipped, before = self.connections <= self.behind, b""
        opened_s, answered_s = loop.time(), -1e9
        try:
            while True:
                request = await reader.readexactly(_HEAD.size)
                number, _, _, unit, function, first, count = _HEAD.unpack(request)
                if loop.time() < opened_s + self.mute_s:
                    continue
                data = b"".join((100 + first + i).to_bytes(2, "big") for i in range(count))
                pdu = bytes((unit, function, len(data))) + data
                if loop.time() < answered_s + self.rest_s:
                    pdu = bytes((unit, function | 0x80, 11))
                answered_s = loop.time()
                answer = struct.pack(">HHH", number + self.step, 0, len(pdu)) + pdu
                answer, before = (before, answer) if slipped else (answer, before)
                writer.write(answer)
        except asyncio.IncompleteReadError:
            pass
        finally:
            writer.close()


async def periods(
    bus: object, folder: Path, period_s: float, notices: list[Notice] | None = None, **options: int
) -> list[list[Reading]]:
    """What 40 periods give; options: of the device."""
    (folder / "two.toml").write_text(PROFILE)
    names = {f"c{i}": i for i in range(4)}
    heard: list[Reading] = []
    driver = make_device("d", bus, str(folder / "two.toml"), 1, names, options, SystemClock())  # type: ignore[arg-type]
    notify = ([] if notices is None else notices).append
    async with Acquisition([Line(bus, (driver,), period_s)], RealClock(), heard.extend, notify):  # type: ignore[arg-type]
        async with asyncio.timeout(1000.0):
            while len(heard) < 4 * PERIODS:
                await asyncio.sleep(period_s)
    return [heard[i : i + 4] for i in range(0, 4 * PERIODS, 4)]


def is_read_soon(seen: list[list[Reading]]) -> None:
    good = [[r.value for r in each if r.quality is Quality.GOOD] for each in seen]
    assert all(set(values) <= set(HELD) for values in good), "no wrong value"
    rate = [sum(values == HELD for values in good[at : at + 10]) for at in (0, 10, 20, 30)]
    print(rate, {r.detail for each in seen for r in each if r.detail})
    assert rate[2] >= 9, rate
    assert rate[3] >= 9, rate


@pytest.mark.parametrize("period_s", [0.5, 1.0, 3.0])
@pytest.mark.parametrize(
    "odd", [{"mute_s": 2.0}, {"rest_s": 0.01}, {"rest_s": 0.2}, {"behind": 1}, {"behind": 3}], ids=str
)
async def test_server(odd: dict[str, float], period_s: float, tmp_path: Path) -> None:
    host = Host()
    for name, value in odd.items():
        setattr(host, name, value)
    async with stream_server(host.serve) as port:
        bus = make_bus("tcp", "modbus_tcp", {"host": "127.0.0.1", "port": port, "timeout_s": TIMEOUT_S})
        is_read_soon(await periods(bus, tmp_path, period_s))


@pytest.mark.parametrize("period_s", [1.0, 3.0])
@pytest.mark.parametrize("rest_s", [0.05, 0.2, 0.35])
async def test_unit_on_a_serial_line_that_needs_a_rest(rest_s: float, period_s: float, tmp_path: Path) -> None:
    async with line(TIMEOUT_S) as (bus, peer):
        peer.reply = resting(rest_s)
        is_read_soon(await periods(bus, tmp_path, period_s))


def resting(rest_s: float) -> Callable[[bytes], bytes]:
    answered_s = -1e9

    def rested(request: bytes) -> bytes:
        nonlocal answered_s
        now_s = asyncio.get_running_loop().time()
        if now_s < answered_s + rest_s:
            return b""
        answered_s = now_s
        return honest(request, 100 + int.from_bytes(request[2:4], "big"))

    return rested


def facts(notices: list[Notice]) -> list[tuple[str, object]]:
    """Code, and the value of the key that states it."""
    told = (n.text for n in notices if n.is_fact)
    return [(text.code, text.value_of("settle_s") or text.value_of("rest_ms")) for text in told]


def is_read_from_the_first(seen: list[list[Reading]]) -> None:
    assert [[r.value for r in each] for each in seen] == [HELD] * PERIODS


async def test_a_connection_that_is_mute_at_first_is_told_once_and_loses_nothing_with_its_key(tmp_path: Path) -> None:
    notices: list[Notice] = []
    host = Host()
    host.mute_s = 2.0
    async with stream_server(host.serve) as port:
        where = {"host": "127.0.0.1", "port": port, "timeout_s": TIMEOUT_S}
        is_read_soon(await periods(make_bus("tcp", "modbus_tcp", where), tmp_path, 1.0, notices))
        [(code, settle_s)] = facts(notices)
        assert code == "modbus_mute"
        assert 2.0 <= float(str(settle_s)) <= 3.2, "it is asked once a period"
        notices.clear()
        is_read_from_the_first(
            await periods(make_bus("tcp", "modbus_tcp", {**where, "settle_s": 2.1}), tmp_path, 1.0, notices)
        )
        assert notices == []


@pytest.mark.parametrize("of", ["unit", "line"])
async def test_a_rest_is_told_once_and_loses_nothing_with_its_key(of: str, tmp_path: Path) -> None:
    notices: list[Notice] = []
    async with line(TIMEOUT_S) as (bus, peer):
        peer.reply = resting(0.29)
        is_read_soon(await periods(bus, tmp_path, 1.0, notices))
        assert facts(notices) == [("needs_rest", 300)]
        notices.clear()
        peer.reply = resting(0.29)
        where = {"port": peer.path, "baud": 115200, "timeout_s": TIMEOUT_S, "rest_ms": 300 * (of == "line")}
        options = {"rest_ms": 300} if of == "unit" else {}
        is_read_from_the_first(await periods(make_bus("rtu", "modbus_rtu", where), tmp_path, 1.0, notices, **options))
        assert notices == []


async def test_a_server_with_numbers_of_its_own_is_told_once(tmp_path: Path) -> None:
    notices: list[Notice] = []
    host = Host()
    host.step = 1
    async with stream_server(host.serve) as port:
        where = {"host": "127.0.0.1", "port": port, "timeout_s": TIMEOUT_S}
        await periods(make_bus("tcp", "modbus_tcp", where), tmp_path, 1.0, notices)
        assert facts(notices) == [("modbus_own_numbers", None)]
        notices.clear()
        bus = make_bus("tcp", "modbus_tcp", {**where, "transaction_id": "ignore"})
        is_read_from_the_first(await periods(bus, tmp_path, 1.0, notices))
        assert notices == []


async def test_a_server_is_left_to_others_between_the_periods(tmp_path: Path) -> None:
    host = Host()
    async with stream_server(host.serve) as port:
        where = {"host": "127.0.0.1", "port": port, "timeout_s": TIMEOUT_S, "close_between_polls": True}
        is_read_from_the_first(await periods(make_bus("tcp", "modbus_tcp", where), tmp_path, 1.0))
    assert host.connections == pytest.approx(PERIODS, abs=2)


@pytest.mark.parametrize("odd", [{"mute_s": 2.0}, {"rest_s": 0.2}, {"step": 1}], ids=str)
async def test_a_single_reading_finds_it_out_too(odd: dict[str, float], tmp_path: Path) -> None:
    host = Host()
    for name, value in odd.items():
        setattr(host, name, value)
    (tmp_path / "two.toml").write_text(PROFILE)
    async with stream_server(host.serve) as port:
        bus = make_bus("tcp", "modbus_tcp", {"host": "127.0.0.1", "port": port, "timeout_s": TIMEOUT_S})
        driver = make_device("d", bus, str(tmp_path / "two.toml"), 1, {"a": 0, "c": 2}, {}, SystemClock())
        [answer] = await read_once(Line(bus, (driver,)), RealClock(), learns=True)
    assert len(bus.learnt()) == 1  # type: ignore[attr-defined]
    assert (answer.error is None) == ("step" not in odd)
