"""A command builds each bus and device once. The check of a configuration builds none, but for kinds of other packages:
these it hands on."""

import asyncio
import importlib
import tomllib
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.base import SetupError
from drivers.canopen.bus import CanOpenBus
from drivers.canopen.cia404 import Cia404Device
from drivers.modbus.device import ModbusDevice
from drivers.modbus.rtu import ModbusRtuBus
from gateway.acquisition.acquisition import Acquisition
from gateway.acquisition.build import lines_of
from gateway.acquisition.once import read_once
from gateway.acquisition.reload import ReloadError, apply, bus_changes, prepare
from gateway.config.file import load
from gateway.config.model import GatewayConfig
from gateway.config.problems import ConfigError
from gateway.control.restart.earlier import EarlierRun
from gateway.service.reloading import Reloading
from gateway.service.service import Service
from gateway.service.serving import serve
from talc.control import Controller
from tests.benches.kept_events import KeptEvents
from tests.benches.reloaded_service import service_of_file
from tests.benches.service_file import UNPUBLISHED, m7015, rtu_bus
from tests.benches.stepped_clock import SteppedClock
from tests.benches.stream_server import stream_server
from tests.benches.waits import until

CAN = """
[[bus]]
name = "can1"
kind = "canopen"
interface = "slcan"
channel = "/nowhere/can"
[[device]]
name = "node"
bus = "can1"
profile = "cia404"
unit = 5
options = { vendor = "jumo" }
channels = { spindle = 0 }
"""
TEXT = UNPUBLISHED + rtu_bus() + m7015() + m7015("rtd2", 2, "bed_rear = 0") + CAN
EACH_ONCE = {"rtu1": 1, "can1": 1, "rtd1": 1, "rtd2": 1, "node": 1}


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """How many were made, by the name of the bus or device: the first argument of each."""
    names: Counter[str] = Counter()

    def counted(init: Callable[..., None]) -> Callable[..., None]:
        def count(self: object, name: str, *others: object) -> None:
            names[name] += 1
            init(self, name, *others)

        return count

    for kind in (ModbusRtuBus, ModbusDevice, CanOpenBus, Cia404Device):
        monkeypatch.setattr(kind, "__init__", counted(kind.__init__))
    return names


def configuration(folder: Path, text: str = TEXT) -> GatewayConfig:
    file = folder / "gateway.toml"
    file.write_text(text)
    return load(file)


def test_the_check_makes_none(tmp_path: Path, made: Counter[str]) -> None:
    configuration(tmp_path)
    assert made == {}


@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        ("unit = 2", "unit = 248"),
        ("unit = 1\n", "unit = 1\noptions = { address_offset = -1 }\n"),
        ("unit = 1\n", "unit = 1\noptions = { address_offset = 65536 }\n"),
        ("unit = 1\n", "unit = 1\noptions = { address_offset = 65530 }\n"),
        ("bed_front = 0", "bed_front = 6"),
        ('vendor = "jumo"', 'vendor = "acme"'),
        ('vendor = "jumo"', 'vendor = "jumo", transfer = "never"'),
        ('profile = "cia404"', 'profile = "icpdas_m7015"'),
    ],
)
def test_the_check_still_finds_what_a_driver_refuses(tmp_path: Path, right: str, wrong: str) -> None:
    """What would be refused when the drivers are made is refused by the check already, with the same text."""
    good, changed = configuration(tmp_path), TEXT.replace(right, wrong, 1)
    assert changed != TEXT
    with pytest.raises(ConfigError) as found:
        configuration(tmp_path, changed)
    whole = good.model_dump(by_alias=True) | {"device": tomllib.loads(changed)["device"]}
    with pytest.raises(SetupError) as refused:
        lines_of(GatewayConfig.model_validate(whole), SteppedClock())
    assert refused.value.what in str(found.value)


async def test_run_makes_each_once(tmp_path: Path, made: Counter[str]) -> None:
    config, stop = configuration(tmp_path), asyncio.Event()
    await serve(config, SteppedClock(), stop, simulated=False, started=lambda _: stop.set())
    assert made == EACH_ONCE


async def test_a_reload_makes_what_it_exchanges(tmp_path: Path, made: Counter[str]) -> None:
    old, clock = configuration(tmp_path), SteppedClock()
    async with Acquisition(lines_of(old, clock), clock, lambda _: None, lambda _: None) as acquisition:
        new = configuration(tmp_path, TEXT.replace("/nowhere/adapter", "/nowhere/other"))
        made.clear()
        await apply(acquisition, prepare(old, new, clock))
    assert made == {"rtu1": 1, "rtd1": 1, "rtd2": 1}


@pytest.mark.parametrize("by_signal", [True, False], ids=["signal", "command"])
async def test_a_reload_of_the_service_makes_what_it_exchanges_once(
    tmp_path: Path, made: Counter[str], by_signal: bool
) -> None:
    config, clock, stop = configuration(tmp_path), SteppedClock(), asyncio.Event()
    service = Service(config, clock, KeptEvents(), EarlierRun(Controller(config.input_names, config.talc)))
    reloading = Reloading(tmp_path / "gateway.toml")
    tasks = [asyncio.create_task(service.run(stop)), asyncio.create_task(reloading.run(service))]
    try:
        await clock.run_until(3.0)
        made.clear()
        new = configuration(tmp_path, TEXT.replace("/nowhere/adapter", "/nowhere/other"))
        if by_signal:
            reloading.hang_up()
        else:
            await reloading.ask(service)
        await until(lambda: service.fingerprint == new.fingerprint())
        assert made == {"rtu1": 1, "rtd1": 1, "rtd2": 1}
    finally:
        stop.set()
        tasks[1].cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


OTHERS = """
[[bus]]
name = "board"
kind = "text_tcp"
host = "127.0.0.1"
port = 1
[[device]]
name = "board1"
bus = "board"
profile = "numbers"
channels = { bed = 0 }
[[device]]
name = "board2"
bus = "board"
profile = "numbers"
unit = 2
channels = { column = 1 }
[nc]
kind = "text_axes"
host = "127.0.0.1"
port = 1
"""


@pytest.fixture
def others_made(example: Path, monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """How many of each class the package of examples/extension has made. Its control has a bus of its own."""
    names: Counter[str] = Counter()

    def counted(kind: type, init: Callable[..., None]) -> Callable[..., None]:
        def count(self: object, *given: object) -> None:
            names[kind.__name__] += 1
            init(self, *given)

        return count

    boards, axes = importlib.import_module("talc_example.text_tcp"), importlib.import_module("talc_example.text_axes")
    for kind in (boards.TextTcpBus, boards.TextTcpDevice, axes.TextAxes):
        monkeypatch.setattr(kind, "__init__", counted(kind, kind.__init__))
    return names


OTHERS_EACH_ONCE = {"TextTcpBus": 2, "TextTcpDevice": 2, "TextAxes": 1}


@pytest.mark.usefixtures("no_package_stays_loaded")
async def test_run_uses_what_the_check_of_another_package_made(tmp_path: Path, others_made: Counter[str]) -> None:
    stop, clock = asyncio.Event(), SteppedClock()
    config = configuration(tmp_path, UNPUBLISHED + OTHERS)
    assert others_made == OTHERS_EACH_ONCE, "the check"
    await serve(config, clock, stop, simulated=False, started=lambda _: stop.set())
    assert others_made == OTHERS_EACH_ONCE, "and the service"
    lines = lines_of(config, clock)
    assert lines[0].bus is not lines_of(config, clock)[0].bus, "no two commands share a connection"


@pytest.mark.usefixtures("no_package_stays_loaded", "example")
async def test_what_the_check_made_has_the_clock_of_who_uses_it(tmp_path: Path) -> None:
    async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while await reader.readline():
            writer.write(b"21.5 7\n")
        writer.close()

    clock = SteppedClock()
    clock.spend(1234.0)
    async with stream_server(answer) as port:
        config = configuration(tmp_path, UNPUBLISHED + OTHERS.replace("port = 1", f"port = {port}", 1))
        (line,) = lines_of(config, clock)
        first, second = await read_once(line, clock)
    times = [(r.monotonic_s, r.source_time) for r in (*first.readings, *second.readings)]
    assert times == [(1234.0, clock.utc())] * 2


@pytest.mark.usefixtures("no_package_stays_loaded")
async def test_a_reload_leaves_what_the_check_made_to_the_service(tmp_path: Path, others_made: Counter[str]) -> None:
    path = tmp_path / "gateway.toml"
    service = service_of_file(path, KeptEvents(), SteppedClock())
    path.write_text(UNPUBLISHED + OTHERS, encoding="utf-8")
    with pytest.raises(ReloadError, match="restart the gateway"):  # its [nc] is another one: read, not applied
        await Reloading(path).ask(service)
    assert others_made == OTHERS_EACH_ONCE


@pytest.mark.usefixtures("no_package_stays_loaded")
def test_a_kept_driver_changes_neither_the_section_nor_a_reload(tmp_path: Path, others_made: Counter[str]) -> None:
    used, unused = (configuration(tmp_path, UNPUBLISHED + OTHERS) for _ in range(2))
    lines_of(used, SteppedClock())
    assert used.buses == unused.buses
    assert used.fingerprint() == unused.fingerprint()
    assert bus_changes(used, unused).kept == ("board",)
    made = others_made.copy()
    lines_of(unused, SteppedClock())
    assert others_made == made
