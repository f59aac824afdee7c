"""Whatever a Modbus device's registers and bits contain, a read gives a number within its profile or a fault, over
loopback."""

import asyncio
from collections.abc import Mapping
from contextlib import AsyncExitStack
from importlib.resources import files
from math import isnan
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.base import Driver, DriverError, Quality, SystemClock
from drivers.build import make_device
from drivers.modbus.profile import ModbusProfile
from drivers.profiles import load_profile, profile_names
from simulators.devices import TcpHost
from tests.benches.buses import make_bus

pytestmark = pytest.mark.simulated_time

USER = """
protocol = "modbus"
title = "Real numbers"
buses = ["modbus_tcp"]
channels = 4
unit = "degC"
[value]
function = 3
address = 0
type = "float32"
[plausibility]
low = -50.0
high = 150.0
"""


WORD = st.one_of(st.integers(0, 65535), st.sampled_from([0, 1, 0x7FFF, 0x8000, 0x7FC0, 0xFFFF]))


class AnyMemory:
    """A unit whose memory the test fills; settings and type codes are right ones."""

    silent = False

    def __init__(self) -> None:
        self.words: list[int] = [0]
        self.codes: dict[tuple[int, int], int] = {}

    def memory(self, function: int) -> Mapping[int, int]:
        word = {address: self.words[address % len(self.words)] for address in range(300)}
        if function <= 2:
            word = {address: value & 1 for address, value in word.items()}
        return word | {address: code for (space, address), code in self.codes.items() if space == function}


def modbus_profile(name: str, folder: Path) -> ModbusProfile:
    if name == "user":
        (folder / "user.toml").write_text(USER)
        name = str(folder / "user.toml")
    profile = load_profile(name)
    assert isinstance(profile, ModbusProfile)
    return profile


def modbus_profiles() -> list[str]:
    return ["user", *(name for name in profile_names() if isinstance(load_profile(name), ModbusProfile))]


@pytest.mark.parametrize("name", modbus_profiles())
def test_any_memory_gives_numbers_within_the_range_or_faults(name: str, tmp_path: Path) -> None:
    profile, unit, stack = modbus_profile(name, tmp_path), AnyMemory(), AsyncExitStack()
    low, high = -3276.8, 3276.7
    unit.codes = {(setting.function, setting.address): setting.equals for setting in profile.settings}
    if (codes := profile.type_codes) is not None:
        code, span = next(iter(codes.spans.items()))
        unit.codes |= {(codes.function, codes.address + i): code for i in range(profile.channels)}
        low, high = 1.01 * span.low - 0.01 * span.high, 1.01 * span.high - 0.01 * span.low
    if profile.plausibility is not None:
        low, high = profile.plausibility.low, profile.plausibility.high

    async def start() -> Driver:
        host = TcpHost({1: unit})
        bus = make_bus("tcp", "modbus_tcp", {"host": "127.0.0.1", "port": await host.start()})
        stack.push_async_callback(host.stop)
        stack.push_async_callback(bus.close)
        await bus.connect()
        channels = {f"c{i}": i for i in range(profile.channels)}
        return make_device("d", bus, str(as_tcp), 1, channels, {}, SystemClock())

    as_tcp = tmp_path / "tcp.toml"
    as_tcp.write_text(_over_tcp(name), encoding="utf-8")
    with asyncio.Runner() as runner:
        try:
            driver = runner.run(start())

            @settings(max_examples=60)
            @given(st.lists(WORD, min_size=1, max_size=40))
            def any_words(words: list[int]) -> None:
                unit.words = words
                try:
                    readings = runner.run(driver.read())
                except DriverError:
                    return
                for reading in readings:
                    if reading.quality is Quality.GOOD:
                        assert low - 1e-9 <= reading.value <= high + 1e-9
                    else:
                        assert isnan(reading.value)
                        assert reading.detail

            any_words()
        finally:
            runner.run(stack.aclose())


def _over_tcp(name: str) -> str:
    """The profile's text, allowed on Modbus TCP whatever its device speaks: the bytes of a message are the same."""
    if name == "user":
        return USER
    text = (files("drivers") / "profiles" / f"{name}.toml").read_text(encoding="utf-8")
    return text.replace('buses = ["modbus_rtu"]', 'buses = ["modbus_tcp"]')
