"""Families of drivers: who knows whom, and one of another package, which registers as the gateway's own do."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import grimp
import pytest

import drivers
from drivers.families import BUSES, DEVICES, register
from drivers.family import Family, NoOptions
from tests.benches.extension_package import files_of, install

FAMILIES = {f"drivers.{file.parent.name}" for file in Path(str(drivers.__file__)).parent.glob("*/__init__.py")}
STANDS_ON = {
    ("drivers.sinumerik", "drivers.opcua"),
    ("drivers.canopen", "drivers.can"),
    ("drivers.linuxcnc", "drivers.agent"),
}
TOY = '''"""Counters on a board: each read counts on."""

from typing import ClassVar, Literal

from drivers.base import Quality, Reading
from drivers.bus_settings import BusSettings
from drivers.family import BusKind, DeviceKind, Family
from drivers.profile import DeviceProfile
from drivers.section import Section


class ToySettings(BusSettings):
    """A board of counters."""

    bus_kind: ClassVar[str] = "toy"
    board: str
    """Its name."""

    @property
    def place(self):
        return self.board


class ToyProfile(DeviceProfile):
    buses: ClassVar[tuple[str, ...]] = ("toy",)
    protocol: Literal["toy"]
    channels: int


class ToyOptions(Section):
    start: int = 0


class ToyBus:
    kind = "toy"

    def __init__(self, name, settings, tap):
        self.name, self.timeout_s = name, settings.timeout_s

    async def connect(self): ...
    async def close(self): ...


class ToyDevice:
    def __init__(self, placed, bus, clock):
        self.device, self.channels, self.placed, self.clock = placed.name, tuple(placed.channels), placed, clock

    async def connect(self): ...
    async def close(self): ...

    async def read(self, *, again=False):
        utc, now = self.clock.utc(), self.clock.monotonic()
        return [
            Reading(name, float(self.placed.options.start + n), self.placed.profile.unit, Quality.GOOD, utc, now)
            for name, n in self.placed.channels.items()
        ]


FAMILY = Family((BusKind(ToySettings, ToyBus),), (DeviceKind(ToyProfile, ToyOptions, ToyDevice),))
'''
CONFIG = """[machine]
name = "mill"
[[bus]]
name = "toy1"
kind = "toy"
board = "b"
[[device]]
name = "counter"
bus = "toy1"
profile = "counter.toml"
options = {start = 40}
[device.channels]
one = 2
"""
PROFILE = 'protocol = "toy"\ntitle = "counter"\nunit = "1"\nchannels = 3\n'


def command(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """One command of the gateway in a process that finds the package."""
    return subprocess.run(
        [sys.executable, "-m", "gateway", *words],
        env={**os.environ, "PYTHONPATH": f"{folder / 'site'}:{Path(__file__).parents[2]}"},
        capture_output=True, text=True, check=False,
    )  # fmt: skip


@pytest.mark.slow
def test_a_family_of_another_package_is_a_bus_with_profiles_of_its_own(tmp_path: Path) -> None:
    rows = {"talc_gateway.buses": {"toy": "toy_package:FAMILY"}}
    install(files_of("toy", rows, {"toy_package.py": TOY}), tmp_path / "site")
    file = tmp_path / "gateway.toml"
    file.write_text(CONFIG, encoding="utf-8")
    (tmp_path / "counter.toml").write_text(PROFILE, encoding="utf-8")
    read = command(tmp_path, "probe", str(file))
    assert read.returncode == 0, read.stdout + read.stderr
    assert "42" in read.stdout
    wrong = CONFIG.replace("start = 40", "star = 40").replace('board = "b"', 'boar = "b"')
    file.write_text(wrong, encoding="utf-8")
    refused = command(tmp_path, "check", str(file))
    assert (refused.returncode, "boar" in refused.stdout + refused.stderr) == (2, True)


def test_no_family_knows_another_one_but_that_on_which_it_stands() -> None:
    graph = grimp.build_graph("drivers", cache_dir=None)
    assert {"drivers.modbus", "drivers.mtconnect"} <= FAMILIES

    def family(module: str) -> str:
        return ".".join(module.split(".")[:2])

    known = {
        (family(module), family(other))
        for module in graph.modules
        for other in graph.find_modules_directly_imported_by(module)
        if family(module) != family(other) and {family(module), family(other)} <= FAMILIES
    }
    assert known == STANDS_ON


def test_a_kind_or_protocol_has_one_family() -> None:
    for taken in (
        Family((replace(BUSES["mqtt"]),), ()),
        Family((), (replace(DEVICES["mqtt"], options=NoOptions, check=print),)),
    ):
        with pytest.raises(ValueError, match="mqtt"):
            register(taken)
