"""Emulated Modbus devices, byte for byte as the standard and the makers' manuals say."""

import asyncio

import pytest

from simulators.devices import M7015, Adam6015, TcpHost
from simulators.devices.modbus_servers import crc16
from simulators.devices.modbus_unit import answer
from simulators.devices.source import SensorFault

pytestmark = pytest.mark.simulated_time

TEMPERATURES = [20.04, 21.26, -3.3, 199.9, 200.1, -200.1]


def test_crc_is_that_of_the_standard() -> None:
    """The check value of CRC-16/MODBUS over the digits 1 to 9 is 4B37."""
    assert crc16(b"123456789") == bytes.fromhex("37 4B")


def test_m7015_quantises_to_a_tenth_and_clips_with_its_sentinels() -> None:
    unit = M7015(lambda: TEMPERATURES)
    assert answer(unit, bytes.fromhex("04 0000 0006")) == bytes.fromhex("04 0C 00C8 00D5 FFDF 07CF 7FFF 8000")


def test_m7015_reports_inputs_out_of_range_by_bits() -> None:
    unit = M7015(lambda: TEMPERATURES)
    unit.faults.set(0, SensorFault.OPEN)
    assert answer(unit, bytes.fromhex("02 0080 0006")) == bytes.fromhex("02 01 31")


@pytest.mark.parametrize(
    ("code", "temperature", "word"),
    [(0x03A4, -50.0, 0), (0x03A4, 50.0, 32768), (0x03A4, 150.0, 65535), (0x03A5, 25.0, 16384), (0x03A4, 400.0, 65535)],
)
def test_adam_spreads_the_range_of_the_type_code_over_16_bits(code: int, temperature: float, word: int) -> None:
    unit = Adam6015(lambda: [temperature] * 7, type_codes=(code,) * 7)
    assert answer(unit, bytes.fromhex("03 0006 0001")) == bytes((3, 2)) + word.to_bytes(2, "big")
    assert answer(unit, bytes.fromhex("03 00C8 0001")) == bytes((3, 2)) + code.to_bytes(2, "big")


def test_adam_reports_burnout_by_coils() -> None:
    unit = Adam6015(lambda: [20.0] * 7)
    unit.faults.set(6, SensorFault.OPEN)
    assert answer(unit, bytes.fromhex("01 0078 0007")) == bytes.fromhex("01 01 40")


@pytest.mark.parametrize(
    ("request_pdu", "exception"),
    [
        pytest.param("04 0006 0001", "84 02", id="behind the last register"),
        pytest.param("04 0005 0002", "84 02", id="over the end"),
        pytest.param("04 0000 0000", "84 03", id="no register"),
        pytest.param("04 0000 007E", "84 03", id="126 registers"),
        pytest.param("06 0000 0001", "86 01", id="writing"),
    ],
)
def test_exceptions(request_pdu: str, exception: str) -> None:
    unit = M7015(lambda: TEMPERATURES)
    assert answer(unit, bytes.fromhex(request_pdu)) == bytes.fromhex(exception)


async def test_tcp_host_answers_with_the_requests_number_and_ignores_unknown_units() -> None:
    host = TcpHost({1: Adam6015(lambda: [50.0] * 7)})
    port = await host.start()
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(bytes.fromhex("0007 0000 0006 09 03 0000 0001"))
    writer.write(bytes.fromhex("0008 0000 0006 01 03 0000 0001"))
    assert await reader.readexactly(11) == bytes.fromhex("0008 0000 0005 01 03 02 8000")
    writer.close()
    await writer.wait_closed()
    await host.stop()


@pytest.mark.parametrize("reason", ["another protocol", "stopped"])
async def test_tcp_host_hangs_up(reason: str) -> None:
    host = TcpHost({1: Adam6015(lambda: [50.0] * 7)})
    reader, writer = await asyncio.open_connection("127.0.0.1", await host.start())
    try:
        if reason == "stopped":
            writer.write(bytes.fromhex("0008 0000 0006 01 03 0000 0001"))
            await reader.readexactly(11)
            await host.stop()
        else:
            writer.write(b"GET / HTTP/1.1\r\n\r\n")
        with pytest.raises((ConnectionResetError, asyncio.IncompleteReadError)):
            await reader.readexactly(1)
    finally:
        writer.close()
        await host.stop()
