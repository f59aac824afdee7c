"""Units on a serial line that refuse with another function's code than they were asked with.

Such a refusal carries no number: it may as well be the late refusal of another request.
"""

import asyncio
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.base import BadAnswer, NoAnswer, Quality, Reading, Refused, SystemClock
from drivers.build import make_device
from drivers.modbus.numbers import Block
from gateway.acquisition.acquisition import Acquisition
from gateway.acquisition.line import Line
from gateway.model.notice import Notice
from gateway.runtime.clocks import RealClock
from tests.benches.rtu_talk import TWO, RtuPeer, frame, honest, line

pytestmark = pytest.mark.simulated_time

PERIOD_S, TIMEOUT_S = 1.0, 0.4
PROFILE = """
protocol = "modbus"
title = "Somebody's module"
buses = ["modbus_rtu"]
unit = "degC"
[[block]]
function = 4
address = 0
channels = 30
type = "int16"
scale = 0.1
"""
CODES = [0x80, 0x81, 0x82, 0x83, 0x90, 0xFF]


def refusing(code: int, exception: int, refused: Callable[[int, int], bool]) -> Callable[[bytes], bytes]:
    """The answer of a unit whose register n contains n, and that refuses some requests with this function code."""

    def reply(request: bytes) -> bytes:
        first, count = int.from_bytes(request[2:4], "big"), int.from_bytes(request[4:6], "big")
        return frame(bytes((request[0], code, exception))) if refused(first, count) else honest(request, first)

    return reply


async def heard_of(
    reply: Callable[[bytes], bytes], folder: Path, periods: int
) -> tuple[list[Reading], list[Notice], RtuPeer]:
    """What a gateway reads of thirty channels of unit 1, and of one channel of unit 2, which answers correctly."""
    profile = folder / "module.toml"
    profile.write_text(PROFILE)
    heard: list[Reading] = []
    notices: list[Notice] = []
    async with line(TIMEOUT_S) as (bus, peer):
        peer.reply = lambda request: reply(request) if request[0] == 1 else honest(request, 0)
        channels = {f"c{number}": number for number in range(30)}
        drivers = (
            make_device("odd", bus, str(profile), 1, channels, {}, SystemClock()),
            make_device("good", bus, str(profile), 2, {"neighbour": 0}, {}, SystemClock()),
        )
        async with Acquisition([Line(bus, drivers, PERIOD_S)], RealClock(), heard.extend, notices.append):
            await asyncio.sleep((periods - 0.5) * PERIOD_S)
        assert bus.other_master() == "", "its refusals are not another master's"
    return heard, notices, peer


@pytest.mark.parametrize("code", CODES)
async def test_a_refused_address_takes_its_own_channel_and_is_named(code: int, tmp_path: Path) -> None:
    heard, notices, peer = await heard_of(refusing(code, 2, lambda first, n: first <= 7 < first + n), tmp_path, 9)
    late = [reading for reading in heard if reading.monotonic_s >= heard[0].monotonic_s + 3 * PERIOD_S]
    assert {r.channel for r in late if r.quality is not Quality.GOOD} == {"c7"}
    assert {r.quality for r in heard if r.channel == "neighbour"} == {Quality.GOOD}
    good = [reading for reading in heard if reading.quality.usable and reading.channel != "neighbour"]
    assert all(reading.value == pytest.approx(int(reading.channel[1:]) / 10) for reading in good)
    told = [notice.text for notice in notices if not notice.ended]
    assert any("address 7, count 1 with exception 2: illegal data address" in text for text in told), told
    assert len(peer.requests) <= 60, "it is not asked for over and over"


@pytest.mark.parametrize("code", CODES)
async def test_one_that_refuses_everything_does_not_delay_its_neighbour(code: int, tmp_path: Path) -> None:
    heard, notices, _ = await heard_of(refusing(code, 2, lambda *_: True), tmp_path, 9)
    assert {r.quality for r in heard if r.channel == "neighbour"} == {Quality.GOOD}
    assert {r.quality for r in heard if r.channel != "neighbour"} == {Quality.COMM_FAULT}
    (told,) = [notice.text for notice in notices]
    assert "bus bus1, device odd: unit 1 answered function 4, address 0, count 30 with exception 2" in told


async def test_a_busy_unit_is_asked_again_whatever_function_it_names(tmp_path: Path) -> None:
    asked = 0

    def now_and_then(_first: int, _count: int) -> bool:
        nonlocal asked
        asked += 1
        return asked % 3 == 0

    heard, notices, _ = await heard_of(refusing(0x83, 6, now_and_then), tmp_path, 9)
    assert {reading.quality for reading in heard} == {Quality.GOOD}
    assert notices == []


async def test_it_is_an_answer_at_once() -> None:
    async with line(TIMEOUT_S) as (bus, peer):
        peer.reply = lambda request: frame(bytes((request[0], 0x83, 2)))
        began_s = asyncio.get_running_loop().time()
        with pytest.raises(Refused, match="unit 1 answered function 4, address 0, count 2 with exception 2"):
            await bus.read("d", 1, TWO)
        assert asyncio.get_running_loop().time() - began_s < TIMEOUT_S / 2
        peer.reply = honest
        peer.requests.clear()
        assert await bus.read("d", 1, TWO) == (100, 101)
        assert len(peer.requests) == 1, "no answer is due that must be distinguished from this one"


async def test_the_answer_that_follows_is_better() -> None:
    """The refusal was then the late or repeated one of another request."""
    async with line(TIMEOUT_S) as (bus, peer):
        peer.reply = lambda request: frame(bytes((1, 0x83, 2))) + honest(request)
        assert await bus.read("d", 1, TWO) == (100, 101)


async def test_a_late_refusal_is_not_taken_for_that_of_another_function() -> None:
    """The unit refuses function 3 late, in the time of function 4, whose own answer is late, too."""
    async with line(TIMEOUT_S) as (bus, peer):
        late = frame(bytes((1, 0x83, 2)))
        with pytest.raises(NoAnswer):
            await bus.read("d", 1, Block(3, 0, 2))
        peer.reply = lambda _: late
        with pytest.raises(NoAnswer, match="it answers later"):
            await bus.read("d", 1, TWO)
        peer.reply = honest
        assert await bus.read("d", 1, TWO) == (100, 101)


async def test_a_refusal_of_another_unit_is_not_ours() -> None:
    async with line(TIMEOUT_S) as (bus, peer):
        peer.reply = lambda _: frame(bytes((2, 0x83, 6)))
        with pytest.raises(BadAnswer, match="no valid answer of unit 1"):
            await bus.read("d", 1, TWO)
