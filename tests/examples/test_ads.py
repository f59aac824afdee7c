"""The installed package of examples/ads reads a PLC that the library's own test server plays."""

import asyncio
import itertools
import math
import os
import socket
import struct
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import pytest
from click.testing import CliRunner
from pyads import constants
from pyads.testserver import AdsTestServer, AdvancedHandler, PLCVariable
from pyads.testserver.handler import AmsPacket, AmsResponseData

from drivers.base import BadAnswer, ConnectError, NoAnswer, Refused, WrongDevice
from drivers.nc import NumericalControl, WatchdogTerms
from gateway.cli.main import main
from gateway.config.file import parse
from gateway.config.problems import ConfigError
from gateway.nc.build import control_of
from gateway.runtime.clocks import RealClock
from tests.benches.extension_package import example_files, install

# The test server of the library pyads as a TwinCAT PLC; Beckhoff's own client talks to it.


PORT, NO_SYMBOL = 48898, 1808
_REPLY = struct.pack("<H", 5)
_READ_STATE = struct.pack("<H", constants.ADSCOMMAND_READSTATE)
_NUMBERS = itertools.count(1)


class EmulatedPlc(AdvancedHandler):  # type: ignore[misc]
    """Variables, and the state of the program."""

    def __init__(self, values: Mapping[str, float | bool]) -> None:
        super().__init__()
        self.running = True
        for name, value in values.items():
            if isinstance(value, bool):
                self.add_variable(PLCVariable(name, int(value), constants.ADST_BIT, "BOOL"))
            else:
                self.add_variable(PLCVariable(name, value, constants.ADST_REAL64, "LREAL"))

    def set(self, name: str, value: float | bool) -> None:
        """Set a value, as the PLC's program would."""
        self.get_variable_by_name(name).value = struct.pack("<?" if isinstance(value, bool) else "<d", value)

    def exchange_places(self, one: str, other: str) -> None:
        """Exchange two variables' places, as loading another program would."""
        first, second = self.get_variable_by_name(one), self.get_variable_by_name(other)
        first.index_offset, second.index_offset = second.index_offset, first.index_offset
        self.add_variable(first)
        self.add_variable(second)

    def handle_request(self, request: AmsPacket) -> AmsResponseData:
        if request.ams_header.command_id == _READ_STATE and not self.running:
            stopped = struct.pack("<IHH", 0, constants.ADSSTATE_STOP, 0)
            return AmsResponseData(_REPLY, request.ams_header.error_code, stopped)
        try:
            return super().handle_request(request)
        except KeyError:  # a PLC answers that there is no such variable
            return AmsResponseData(_REPLY, request.ams_header.error_code, struct.pack("<II", NO_SYMBOL, 0))


class _Server(AdsTestServer):  # type: ignore[misc]
    """Its socket stays open while its thread looks at it."""

    def stop(self) -> None:
        self._run = False
        if self.is_alive():
            self.join()
        super().stop()


def unused_host() -> str:
    """An unused loopback address: ADS has one fixed port, so each server needs its own address."""
    return f"127.{(os.getpid() >> 8) % 254 + 1}.{os.getpid() % 254 + 1}.{next(_NUMBERS)}"


@contextmanager
def ads_server(plc: EmulatedPlc) -> Iterator[str]:
    """Run a server inside; yields its address."""
    host = unused_host()
    server = _Server(handler=plc, ip_address=host, logging=False)
    server.start()
    _until_it_listens(host)  # one that is stopped before that never ends
    try:
        yield host
    finally:
        server.stop()


def _until_it_listens(host: str) -> None:
    latest_s = time.monotonic() + 60.0
    while True:
        try:
            socket.create_connection((host, PORT)).close()
        except ConnectionRefusedError:
            if time.monotonic() > latest_s:
                raise
            time.sleep(0.01)
        else:
            return


pytestmark = pytest.mark.filterwarnings(
    "ignore::pytest.PytestUnhandledThreadExceptionWarning"
)  # of the server's threads
ROOT = Path(__file__).parents[2]
TEXT = """
[machine]
name = "mill"
[[bus]]
name = "plc"
kind = "modbus_tcp"
host = "127.0.0.1"
[[device]]
name = "adam"
bus = "plc"
profile = "advantech_adam6015"
[device.channels]
ambient = 0
[[state]]
name = "spindle_speed"
[[state]]
name = "speed_X"
[nc]
kind = "ads"
host = "HOST"
net_id = "HOST.1.1"
origin_mm = [0.5, 0, 0]
ready = "MAIN.ready"
timeout_s = 20
[nc.positions]
X = "MAIN.axes[1].NcToPlc.ActPos"
Y = "MAIN.Y"
Z = "MAIN.Z"
A = "MAIN.A"
C = "MAIN.C"
[nc.states.spindle_speed]
symbol = "MAIN.S"
[nc.states.speed_X]
symbol = "MAIN.axes[1].NcToPlc.ActVelo"
factor = 60
"""
VALUES = {
    "MAIN.axes[1].NcToPlc.ActPos": 100.5, "MAIN.Y": -20.0, "MAIN.Z": 30.0, "MAIN.A": 10.0, "MAIN.C": 720.0,
    "MAIN.S": 6000.0, "MAIN.axes[1].NcToPlc.ActVelo": 20.0, "MAIN.ready": True,
}  # fmt: skip


@pytest.fixture(autouse=True)
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    install(example_files(ROOT / "examples" / "ads"), tmp_path / "site")
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    yield tmp_path
    for name in [name for name in sys.modules if name.split(".")[0] == "talc_ads"]:
        del sys.modules[name]


def control(host: str, timeout_s: float = 20.0) -> NumericalControl:
    text = TEXT.replace("HOST", host).replace("timeout_s = 20", f"timeout_s = {timeout_s:g}")
    config = parse(text, Path("gateway.toml"))
    assert config.nc is not None
    return control_of(config.nc, config, RealClock())


async def test_positions_states_and_readiness_come_from_the_variables() -> None:
    plc = EmulatedPlc(VALUES)
    with ads_server(plc) as host:
        nc = control(host)
        await nc.connect()
        it = await nc.snapshot()
        assert it.positions == {"X": 100.0, "Y": -20.0, "Z": 30.0, "A": 10.0, "C": 720.0}
        assert it.states == {"spindle_speed": 6000.0, "speed_X": 1200.0}
        assert (it.ready, it.cannot_probe) == (True, "the control is only read")
        plc.exchange_places("MAIN.Y", "MAIN.Z")
        assert (await nc.snapshot()).positions == it.positions
        plc.set("MAIN.ready", False)
        assert (await nc.snapshot()).ready is False
        with pytest.raises(Refused, match="only read"):
            await nc.claim(7, WatchdogTerms(10.0, 1.0))
        plc.set("MAIN.Y", math.nan)
        with pytest.raises(BadAnswer, match=r"MAIN\.Y = 'nan': expected a number"):
            await nc.snapshot()
        plc.set("MAIN.Y", 1.0)
        plc.running = False
        with pytest.raises(BadAnswer, match=r"ADS state 6 of the PLC, not 5 \(RUN\)"):
            await nc.snapshot()
        await nc.close()
        with pytest.raises(ConnectError, match="connect first"):
            await nc.snapshot()


async def test_a_variable_that_the_plc_does_not_have_is_named() -> None:
    without = {name: value for name, value in VALUES.items() if name != "MAIN.C"}
    says = r"positions\.C = 'MAIN\.C': the PLC has no such variable"
    with ads_server(EmulatedPlc(without)) as host, pytest.raises(WrongDevice, match=says):
        await control(host).connect()


async def test_without_a_plc_there_is_no_connection() -> None:
    host = unused_host()
    with pytest.raises(ConnectError, match=host):
        await control(host).connect()


@pytest.mark.simulated_time
async def test_a_plc_that_says_nothing_is_silent() -> None:
    held: list[asyncio.StreamWriter] = []
    host = unused_host()
    async with await asyncio.start_server(lambda _, writer: held.append(writer), host, PORT):
        with pytest.raises(NoAnswer, match=r"no answer within 0\.2 s"):
            await control(host, timeout_s=0.2).connect()
        for writer in held:
            writer.close()


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('net_id = "HOST.1.1"', 'net_id = "1.2.3.4"', "[nc] net_id: '1.2.3.4': expected six numbers with dots"),
        ('C = "MAIN.C"\n', "", "[nc]: positions = X, Y, Z, A: expected a variable for each of X, Y, Z, A, C"),
        ('name = "spindle_speed"', 'name = "door"', "or name its variable: [nc.states.door] symbol = "),
        (
            "[nc.positions]",
            "[probing]\narmed = true\n[nc.positions]",
            "[probing] armed: true, but a control of kind ",
        ),
    ],
)
def test_mistakes_in_its_section_are_reported_with_their_place(old: str, new: str, says: str) -> None:
    with pytest.raises(ConfigError) as refused:
        parse(TEXT.replace(old, new).replace("HOST", "127.0.0.1"), Path("gateway.toml"))
    assert says in str(refused.value)


def test_check_names_the_package(package: Path) -> None:
    file = package / "gateway.toml"
    file.write_text(TEXT.replace("HOST", "127.0.0.1"))
    done = CliRunner().invoke(main, ["check", str(file)])
    assert done.exit_code == 0, done.output
    assert "[nc] kind 'ads' (talc-ads 0.1.0)" in done.stdout
