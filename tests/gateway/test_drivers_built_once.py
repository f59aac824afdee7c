"""A command builds each bus and device once, and the check of a configuration builds none."""

import asyncio
import tomllib
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.base import SetupError
from drivers.canopen import CanOpenBus, Cia404Device
from drivers.modbus import ModbusDevice, ModbusRtuBus
from gateway.acquisition import Acquisition, apply, lines_of
from gateway.cli.running import serve
from gateway.config import ConfigError, GatewayConfig, load
from tests.benches.service_file import UNPUBLISHED, m7015, rtu_bus
from tests.benches.stepped_clock import SteppedClock

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
        await apply(acquisition, clock, old, new)
    assert made == {"rtu1": 1, "rtd1": 1, "rtd2": 1}
