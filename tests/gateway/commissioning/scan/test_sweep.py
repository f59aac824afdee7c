"""Sweeping a Modbus unit: what is asked of it, and that the form of a sensor that is warmed is found."""

import struct
from collections.abc import AsyncIterator, Mapping
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path

import pytest
from click.testing import CliRunner

from drivers.base import NoAnswer
from drivers.modbus.bus import ModbusTcpBus
from drivers.modbus.settings import ModbusTcpSettings
from gateway.cli.main import main
from gateway.commissioning.inspection.sweep import swept
from gateway.config.file import load
from simulators.devices import TcpHost
from simulators.devices.modbus_unit import ModbusUnit
from tests.benches.command import beside
from tests.benches.started import started

pytestmark = pytest.mark.simulated_time

COLD = (21.25, 21.5, 20.75, 22.0)
FIRST = 256


class Module:
    """Four temperatures from FIRST on in one table, beside a serial number and a counter; the second is warm once all
    tables have been read."""

    silent = False

    def __init__(self, table: int, form: str, scale: float, swap: bool) -> None:
        self._table, self._form, self._scale, self._swap = table, form, scale, swap
        self.asked: list[int] = []

    def memory(self, function: int) -> Mapping[int, int]:
        self.asked.append(function)
        if function != self._table:
            return {}
        warm = 6.5 if 2 in self.asked else 0.0
        values = [value + warm * (i == 1) for i, value in enumerate(COLD)]
        words: list[int] = []
        for value in values:
            number = value / self._scale if self._form == "f" else round(value / self._scale)
            data = struct.pack(f">{self._form}", number)
            pair = [int.from_bytes(data[i : i + 2], "big") for i in range(0, len(data), 2)]
            words += reversed(pair) if self._swap else pair
        return dict(enumerate(words, FIRST)) | {0: 0xBEEF, 1: 0x1234, 2: len(self.asked) + 30_000}


def host_of(unit: ModbusUnit) -> AbstractAsyncContextManager[int]:
    return started(TcpHost({7: unit}))


@asynccontextmanager
async def bus_to(unit: ModbusUnit) -> AsyncIterator[ModbusTcpBus]:
    async with host_of(unit) as port:
        bus = ModbusTcpBus("sweep", ModbusTcpSettings(host="127.0.0.1", port=port, timeout_s=5.0))
        await bus.connect()
        yield bus
        await bus.close()


@pytest.mark.parametrize(
    ("table", "form", "scale", "swap"),
    [(3, "h", 0.1, False), (4, "h", 0.01, False), (4, "f", 1.0, False), (3, "f", 1.0, True), (3, "i", 0.001, True)],
)
def test_the_draft_of_a_swept_unit_reads_its_temperatures(
    table: int, form: str, scale: float, swap: bool, tmp_path: Path
) -> None:
    file, config = tmp_path / "module.toml", tmp_path / "gateway.toml"
    with beside(host_of(Module(table, form, scale, swap))) as port:
        words = ["inspect", "sweep", f"127.0.0.1:{port}", "--unit", "7", "--most", "500", "--draft", str(file)]
        done = CliRunner().invoke(main, words, input="\n", env={"COLUMNS": "200"})
        assert done.exit_code == 0, done.output
        config.write_text(
            f'''[machine]
name = "mill"
[[bus]]
name = "tcp1"
kind = "modbus_tcp"
host = "127.0.0.1"
port = {port}
[[device]]
name = "new"
bus = "tcp1"
profile = "module.toml"
unit = 7
[device.channels]
t0 = 0
t1 = 1
t2 = 2
t3 = 3
''', encoding="utf-8")  # fmt: skip
        load(config)
        probed = CliRunner().invoke(main, ["probe", str(config)], env={"COLUMNS": "200"})
    assert "4 of 4 good" in probed.output
    for name, value in zip(("t0", "t1", "t2", "t3"), (21.25, 28.0, 20.75, 22.0), strict=True):
        (line,) = [line for line in probed.output.splitlines() if f" {name} " in line]
        assert float(line.split("│")[4].split()[0]) == pytest.approx(value, abs=scale / 2 + 1e-6)


async def test_an_empty_address_costs_about_one_request_and_nothing_is_written() -> None:
    module = Module(3, "h", 0.1, False)
    async with bus_to(module) as bus:
        found = await swept(bus, 7, 500)
    assert set(found[3].words) == {0, 1, 2, *range(FIRST, FIRST + 4)}
    assert set(found) == {3}
    assert set(module.asked) <= {1, 2, 3, 4}
    assert len(module.asked) < 1500, "in four tables of 500"


async def test_what_is_not_answered_is_left_out_and_a_unit_that_is_not_there_is_told() -> None:
    module = Module(3, "h", 0.1, False)
    asked = iter(range(10_000))

    class Silent:
        """To the twelfth request, which is for an empty block, and when that is repeated."""

        silent = property(lambda _: next(asked) in (11, 12))
        memory = staticmethod(module.memory)

    async with bus_to(Silent()) as bus:
        assert len((await swept(bus, 7, 500, (3,)))[3].words) == 7
        with pytest.raises(NoAnswer):
            await swept(bus, 8, 500)
