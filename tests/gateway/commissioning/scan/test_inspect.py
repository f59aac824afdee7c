"""`inspect registers`: what a third-party server contains, read in every way, and the draft of a profile from it."""

import asyncio
import struct
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from pymodbus.pdu import ModbusPDU
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from drivers.modbus.numbers import NumberFormat
from gateway.cli.main import main
from gateway.commissioning.scan.registers import SeenWords, read_words
from simulators.devices import M7015, RtuLine
from tests.benches.free_port import free_port
from tests.benches.modbus_host import modbus_host
from tests.benches.started import started
from tests.benches.terminal_tables import row_of

TEMPERATURES = (21.25, -3.5, 100.125)
SWAPPED = [word for value in TEMPERATURES for word in reversed(struct.unpack(">2H", struct.pack(">f", value)))]
"""The temperatures as float32 with the words swapped."""
UNIT = 7


@asynccontextmanager
async def pymodbus_server(
    holding: Sequence[SimData], discrete: Sequence[SimData] = ()
) -> AsyncIterator[tuple[int, list[int]]]:
    """Its port, and the function codes that it was asked for."""
    asked: list[int] = []

    def note(sending: bool, pdu: ModbusPDU) -> ModbusPDU:
        if not sending:
            asked.append(pdu.function_code)
        return pdu

    empty = SimData(0, values=0, datatype=DataType.REGISTERS)
    bits = list(discrete) or [SimData(0, values=False, datatype=DataType.BITS)]
    device = SimDevice(UNIT, ([SimData(0, values=False, datatype=DataType.BITS)], bits, list(holding), [empty]))
    port = free_port()
    server = ModbusTcpServer(device, address=("127.0.0.1", port), trace_pdu=note)
    await server.serve_forever(background=True)
    try:
        yield port, asked
    finally:
        await server.shutdown()  # type: ignore[no-untyped-call]


async def inspect(where: str, *arguments: str) -> Result:
    command = ["inspect", "registers", where, *arguments, "--timeout", "60"]
    return await asyncio.to_thread(CliRunner().invoke, main, command, env={"COLUMNS": "200"})


async def test_every_number_stands_side_by_side_and_the_draft_reads_the_same(tmp_path: Path) -> None:
    file = tmp_path / "meter.toml"
    async with pymodbus_server([SimData(100, values=SWAPPED, datatype=DataType.REGISTERS)]) as (port, asked):
        where = f"127.0.0.1:{port}"
        options = ("--unit", "7", "--type", "float32", "--word-order", "little", "--quantity", "K", "--draft")
        done = await inspect(where, "100-105", *options, str(file))
        assert done.exit_code == 0, done.output
        swapped = next(line for line in done.output.splitlines() if "float32" in line and "21.25" in line)
        assert [cell.strip() for cell in swapped.strip("│").split("│")][4] == "21.25", "in the column of swapped words"
        config = tmp_path / "gateway.toml"
        config.write_text(
            '[machine]\nname = "mill"\n[[bus]]\nname = "tcp1"\nkind = "modbus_tcp"\nhost = "127.0.0.1"\n'
            f"port = {port}\ntimeout_s = 60\nread_limit_s = 60\nperiod_s = 60\n"
            '[[device]]\nname = "new"\nbus = "tcp1"\nprofile = "meter.toml"\nunit = 7\n'
            "channels = { a = 0, b = 1, c = 2 }\n"
        )
        assert CliRunner().invoke(main, ["check", str(config)]).exit_code == 0
        probed = await asyncio.to_thread(CliRunner().invoke, main, ["probe", str(config)], env={"COLUMNS": "200"})
    assert [text in probed.output for text in ("21.25 K", "-3.50 K", "100.12 K", "3 of 3 good")] == [True] * 4, (
        probed.output
    )
    assert set(asked) == {3}, "it only reads"


async def test_refused_addresses_are_named_and_take_no_other_with_them(tmp_path: Path) -> None:
    file = tmp_path / "module.toml"
    held = [
        SimData(0, values=[213, 0xFFDF], datatype=DataType.REGISTERS),
        SimData(5, values=[400], datatype=DataType.REGISTERS),
    ]
    async with pymodbus_server(held) as (port, _):
        done = await inspect(f"127.0.0.1:{port}", "0-6", "--unit", "7", "--scale", "0.1", "--draft", str(file))
    assert done.exit_code == 0, done.output
    assert row_of(done.output, "1")[:5] == ["1", "FFDF", "-33", "-3.3", "65503"]
    assert "- unit 7 refuses function 3 at 2-4, 6: exception 2: illegal data address\n" in done.output
    text = file.read_text()
    assert "# Refused, and left out: 2, 3, 4, 6." in text
    assert "# seen: 21.3 -3.3\nfunction = 3\naddress = 0\nchannels = 2" in text
    assert "# seen: 40\nfunction = 3\naddress = 5\nchannels = 1" in text
    assert "max_gap = 0 " in text, "what it refuses is not asked for again"


async def test_numbers_of_64_bits_are_shown_where_they_are_likely() -> None:
    reversed_words = struct.unpack(">4H", struct.pack(">d", 41234.5))[::-1]
    counter = struct.unpack(">4H", struct.pack(">q", 9_000_000_001))
    held = [
        SimData(0, values=list(range(210, 218)), datatype=DataType.REGISTERS),
        SimData(100, values=list(reversed_words), datatype=DataType.REGISTERS),
        SimData(200, values=list(counter), datatype=DataType.REGISTERS),
    ]
    async with pymodbus_server(held) as (port, _):
        done = await inspect(f"127.0.0.1:{port}", "0-7,100-103,200-203", "--unit", "7")
        few = await inspect(f"127.0.0.1:{port}", "0-7", "--unit", "7")
    shown = done.output.partition("four registers each")[2]
    assert row_of(shown, "100")[1:2] + row_of(shown, "100")[4:5] == ["float64", "41234.50"], (
        "in the column of swapped words"
    )
    assert row_of(shown, "200")[1:3] == ["int64", "9000000001"]
    assert "four registers" not in few.output


async def test_bits(tmp_path: Path) -> None:
    file = tmp_path / "contacts.toml"
    bits = [SimData(0, values=[True, False, True, True] + [False] * 12, datatype=DataType.BITS)]
    async with pymodbus_server([SimData(0, values=0, datatype=DataType.REGISTERS)], bits) as (port, asked):
        done = await inspect(f"127.0.0.1:{port}", "0-3", "--unit", "7", "--function", "2", "--draft", str(file))
    assert done.exit_code == 0, done.output
    assert [row_of(done.output, str(i))[1] for i in range(4)] == ["1", "0", "1", "1"]
    assert "# seen: 1011\n" in file.read_text()
    assert set(asked) == {2}


async def test_serial_line() -> None:
    async with started(RtuLine({3: M7015(lambda: [20.0, 21.3, -3.3, 40.0, 50.0, 60.0])})) as path:
        done = await inspect(path, "0-5", "--unit", "3", "--function", "4", "--baud", "115200")
    assert done.exit_code == 0, done.output
    assert row_of(done.output, "1")[:4] == ["1", "00D5", "213", "21.3"]


@pytest.mark.parametrize(
    ("options", "code", "told"),
    [
        (("--quantity", "banana"), 2, "'banana' is unknown: expected one of degC"),
        (("--type", "float64"), 2, "no 4 neighbouring registers were read, as float64 needs"),
        (("--unit", "0", "--draft", "-"), 2, "does not end in .toml"),
    ],
)
async def test_an_impossible_draft_leaves_no_file(
    tmp_path: Path, options: tuple[str, ...], code: int, told: str
) -> None:
    file = tmp_path / "draft.toml"
    async with pymodbus_server([SimData(0, values=[1, 2], datatype=DataType.REGISTERS)]) as (port, _):
        done = await inspect(f"127.0.0.1:{port}", "0-1", "--unit", "7", "--draft", str(file), *options)
    assert done.exit_code == code, done.output
    assert told in done.output
    assert not file.exists()


async def test_an_existing_file_is_kept(tmp_path: Path) -> None:
    file = tmp_path / "draft.toml"
    file.write_text("mine")
    done = await inspect("127.0.0.1:1", "0-1", "--draft", str(file))
    assert done.exit_code == 2
    assert "already exists" in done.output
    assert file.read_text() == "mine"


@pytest.mark.simulated_time
async def test_one_lost_answer_costs_nothing() -> None:
    lost = 0

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        nonlocal lost
        while request := await reader.read(260):
            if lost == 0:
                lost += 1
                continue
            writer.write(request[:4] + bytes((0, 5, request[6], 3, 2, 0, 213)))
        writer.close()

    async with modbus_host(serve, 0.2) as bus:
        seen = await read_words(bus, UNIT, 3, [17])
    assert (lost, seen.words) == (1, {17: 213})


@pytest.mark.simulated_time
async def test_a_unit_that_is_busy_for_a_while_is_asked_again() -> None:
    busy = 0

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        nonlocal busy
        while request := await reader.read(260):
            if busy < 5:
                busy += 1
                writer.write(request[:4] + bytes((0, 3, request[6], 0x83, 6)))
                continue
            writer.write(request[:4] + bytes((0, 5, request[6], 3, 2, 0, 213)))
        writer.close()

    async with modbus_host(serve, 5.0) as bus:
        seen = await read_words(bus, UNIT, 3, [17])
    assert (busy, seen.words, seen.refused) == (5, {17: 213}, {})


@pytest.mark.simulated_time
async def test_a_unit_that_gives_no_half_of_a_number_is_divided_between_its_numbers() -> None:
    """Its numbers have two registers each, and it does not have 8 and 9."""

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while request := await reader.read(260):
            first, count = struct.unpack(">HH", request[8:12])
            if first % 2 or count % 2 or first <= 8 < first + count:
                writer.write(request[:4] + bytes((0, 3, request[6], 0x83, 2)))
            else:
                words = struct.pack(f">{count}H", *range(first, first + count))
                writer.write(request[:4] + bytes((0, 3 + 2 * count, request[6], 3, 2 * count)) + words)
        writer.close()

    async with modbus_host(serve, 5.0) as bus:
        seen = await read_words(bus, UNIT, 3, range(22))
    assert seen.words == {a: a for a in range(22) if a not in (8, 9)}
    assert list(seen.refused) == [8, 9]


def test_a_number_needs_all_of_its_registers() -> None:
    seen = SeenWords(3, {4: 0x41AA, 5: 0x0000, 9: 1})
    assert seen.numbers(NumberFormat("float32")) == {4: 21.25}
