"""A Modbus unit that returns some registers only together, as one request, and refuses every part of them."""

import asyncio
import struct
from pathlib import Path

import pytest

from drivers.base import Refused, SetupError, SystemClock
from drivers.build import make_device
from drivers.profiles import load_profile
from tests.benches.driver_reads import told
from tests.benches.modbus_host import modbus_host
from tests.benches.refusals import refusing

pytestmark = pytest.mark.simulated_time

FIRST, COUNT = 10, 20
PROFILE = f"""
protocol = "modbus"
title = "meter"
buses = ["modbus_tcp"]
unit = "1"
[[block]]
function = 4
addresses = [{FIRST + 3}, {FIRST + 15}]
type = "uint16"
[[block]]
function = 4
address = 100
type = "uint16"
"""
WHOLE = f"[[whole]]\nfunction = 4\naddress = {FIRST}\ncount = {COUNT}\n"
_HEAD = struct.Struct(">HHHBBHH")


async def meter(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Register n holds n. Of the block it answers nothing but the whole, and of the rest each register alone."""
    try:
        while True:
            number, _, _, unit, function, first, count = _HEAD.unpack(await reader.readexactly(_HEAD.size))
            data = b"".join((first + i).to_bytes(2, "big") for i in range(count))
            pdu = bytes((unit, function, len(data))) + data
            if (first, count) != (FIRST, COUNT) and (count > 1 or first < FIRST + COUNT):
                pdu = bytes((unit, function | 0x80, 2))
            writer.write(struct.pack(">HHH", number, 0, len(pdu)) + pdu)
    except asyncio.IncompleteReadError:
        pass
    finally:
        writer.close()


def written(folder: Path, text: str) -> str:
    (folder / "meter.toml").write_text(text)
    return str(folder / "meter.toml")


async def read(profile: str, channels: dict[str, int]) -> list[object]:
    async with modbus_host(meter, 0.5) as bus:
        driver = make_device("meter", bus, profile, 1, channels, {}, SystemClock())
        await driver.connect()
        for _ in range(8):  # a refusal counts when it is repeated
            try:
                readings = await driver.read()
            except Refused as error:
                last: list[object] = [error.what]
            else:
                last = list(told(readings))
        return last


async def test_it_is_read_by_the_request_that_the_profile_states(tmp_path: Path) -> None:
    profile = written(tmp_path, PROFILE + WHOLE)
    assert await read(profile, {"a": 0, "b": 1, "c": 2}) == [(13.0, "1"), (25.0, "1"), (100.0, "1")]


async def test_without_it_only_the_others_are_read(tmp_path: Path) -> None:
    first, second, other = await read(written(tmp_path, PROFILE), {"a": 0, "b": 1, "c": 2})
    assert isinstance(first, tuple)
    assert isinstance(second, tuple)
    assert (first[0], second[0], other) == ("comm_fault", "comm_fault", (100.0, "1"))


async def test_a_whole_that_is_refused_is_not_divided(tmp_path: Path) -> None:
    profile = written(tmp_path, PROFILE + WHOLE.replace(f"{COUNT}", f"{COUNT - 1}"))
    first, _, other = await read(profile, {"a": 0, "b": 1, "c": 2})
    assert isinstance(first, tuple)
    assert first[0] == "comm_fault"
    assert f"address {FIRST}, count {COUNT - 1}" in str(first[1])
    assert other == (100.0, "1")


async def test_a_block_of_the_profile_that_is_returned_only_as_a_whole_is_found(tmp_path: Path) -> None:
    """Also after another unit has been there, which returns parts."""
    text = PROFILE.replace(f"addresses = [{FIRST + 3}, {FIRST + 15}]", f"address = {FIRST}\nchannels = {COUNT}")
    async with modbus_host(meter, 0.5) as bus:
        driver = make_device("meter", bus, written(tmp_path, text), 1, {"a": 3, "b": 15, "c": 20}, {}, SystemClock())
        for _ in range(2):
            await driver.connect()
            for _ in range(8):
                readings = await driver.read()
            assert list(told(readings)) == [(13.0, "1"), (25.0, "1"), (100.0, "1")]
            assert [text.code for text in bus.learnt()] == ["modbus_whole"]
            await driver.close()


def test_one_that_is_longer_than_an_answer_is_refused(tmp_path: Path) -> None:
    with refusing(SetupError, "whole[0].count: modbus_whole_long"):
        load_profile(written(tmp_path, "max_registers = 10\n" + PROFILE + WHOLE))
