"""A recording contains the user's own profiles and DBC files, so it can be played where these do not exist."""

import asyncio
import shutil
import signal
import sys
import tomllib
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from drivers.modbus.profile import ModbusProfile
from drivers.profiles import load_profile
from gateway.acquisition.wire_log import read_wire_log
from gateway.config.file import load
from gateway.config.packed import packed_toml, unpacked
from gateway.config.problems import ConfigError
from gateway.demo.play import playing, read_wire_recording
from simulators.devices import M7015, RtuLine, SlcanAdapter
from simulators.devices.can_logger import CanLogger
from tests.benches.command import beside, here
from tests.benches.file_waits import text_of
from tests.benches.logger_files import logger_dbc, logger_profile_text
from tests.benches.service_file import UNPUBLISHED, m7015, rtu_bus
from tests.benches.waits import until

SUPPLIED = Path(__file__).parents[4] / "drivers" / "profiles" / "icpdas_m7015.toml"
CAN = """
[[bus]]
name = "can1"
kind = "can"
interface = "slcan"
channel = "{can}"
timeout_s = 2.0
[[device]]
name = "logger"
bus = "can1"
profile = "can/mine.toml"
channels = {{ fluid = 0, hall = 4 }}
"""


def machine(folder: Path, rtu: str = "/dev/a", can: str = "/dev/b", dbc: str = "") -> Path:
    """The configuration of a machine with two profiles of one name; gives its path.

    dbc: what the profile's line is instead of naming the file below it
    """
    for name in ("modbus", "can", "dbc files"):
        (folder / name).mkdir(parents=True)
    (folder / "modbus" / "mine.toml").write_bytes(SUPPLIED.read_bytes())
    named = dbc or f'dbc = "{folder}/dbc files/plant.dbc"  # as the maker sent it'
    text = logger_profile_text("logger").replace('dbc = "logger.dbc"', named)
    (folder / "can" / "mine.toml").write_text(text, encoding="utf-8", newline="\r\n")
    described = logger_dbc() + 'CM_ "Wärme °C";\n'
    (folder / "dbc files" / "plant.dbc").write_text(described, encoding="cp1252", newline="\r\n")
    file = folder / "gateway.toml"
    modbus = rtu_bus(rtu, "period_s = 0.2\ntimeout_s = 0.5")
    module = m7015(channels="bed = 0, column = 4", profile="modbus/mine.toml")
    file.write_text(UNPUBLISHED + modbus + module + CAN.format(can=can), encoding="utf-8")
    return file


@asynccontextmanager
async def own_machine(folder: Path) -> AsyncIterator[Path]:
    """Its devices on their wires; yields its configuration."""
    line, adapter = RtuLine({1: M7015(lambda: [20.5] * 6)}), SlcanAdapter([])
    file = machine(folder, await line.start(), await adapter.start())
    logger = CanLogger(lambda: [30.0, 31.0, 32.0, 33.0, 34.5], adapter.send)
    logger.start()
    try:
        yield file
    finally:
        logger.stop()
        await adapter.stop()
        await line.stop()


@pytest.mark.simulated_time
def test_devices_of_own_profiles_are_played_on_another_computer(tmp_path: Path) -> None:
    wire, folder = tmp_path / "field.wire", tmp_path / "played"
    with beside(own_machine(tmp_path / "machine")) as file:
        recorded = here("record", str(file), "-o", str(wire), "--seconds", "1.5")
    assert recorded.code == 0, recorded.err
    shutil.rmtree(tmp_path / "machine")
    folder.mkdir()
    config = folder / "gateway.toml"
    with beside(playing(*read_wire_recording(wire, folder), folder)):
        probed = here("probe", str(config))
    assert probed.code == 0, probed.out + probed.err
    assert [value for value in ("20.50", "30.00", "34.50") if f" {value} degC" not in probed.out] == []
    assert {path.name for path in (config.parent / "profiles").iterdir()} == {"mine.toml", "mine_2.toml", "mine_2.dbc"}


@pytest.mark.parametrize(
    "dbc",
    [
        'dbc = "../dbc files/plant.dbc"',
        "'dbc' = '../dbc files/plant.dbc'",
        'confirm = ["""\ndbc = 1\n"""]\ndbc="../dbc files/plant.dbc" # \'\'\' and \x7f\'s'.replace("\x7f", ""),
        'confirm = ["\'\'\'", "a\\u007fb"]\ndbc = "../dbc files/plant.dbc"',
    ],
)
def test_profiles_are_unpacked_as_they_were(dbc: str, tmp_path: Path) -> None:
    file = machine(tmp_path / "machine", dbc=dbc)
    config = load(file)
    before = [load_profile(device.profile) for device in config.devices]
    text = packed_toml(config)
    shutil.rmtree(file.parent)
    again = unpacked(text, tmp_path / "field.wire", tmp_path / "play")
    after = [load_profile(device.profile) for device in again.devices]
    assert all(Path(device.profile).is_relative_to(tmp_path / "play" / "profiles") for device in again.devices)
    assert isinstance(before[0], ModbusProfile)
    assert after[0] == before[0]
    assert (after[1].channels, after[1].title, after[1].confirm) == (5, before[1].title, before[1].confirm)
    assert (tmp_path / "play" / "profiles" / "mine_2.dbc").read_text(encoding="cp1252").endswith('CM_ "Wärme °C";\n')
    assert packed_toml(again).split("[files]")[1].count("protocol = ") == 2


def test_profile_is_readable_in_the_recording(tmp_path: Path) -> None:
    text = packed_toml(load(machine(tmp_path)))
    assert SUPPLIED.read_text(encoding="utf-8") in text
    assert tomllib.loads(text)["device"][1]["profile"] == "mine_2.toml"
    assert str(tmp_path) not in text, "nothing of the computer's folders"


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        (
            "../mine.toml",
            "'x'",
            "[files] ../mine.toml: expected the name of a .toml, .dbc or .eds file, without a folder",
        ),
        ("/tmp/mine.toml", "'x'", "expected the name of a .toml, .dbc or .eds file"),
        (".bashrc", "'x'", "expected the name of a .toml, .dbc or .eds file"),
        ("mine.toml", "3", "[files] mine.toml: 3: expected a text in quotes"),
        ("mine.dbc", "'\ufffd'", "[files] mine.dbc: holds '\ufffd', not cp1252"),
    ],
)
def test_files_of_a_recording_stay_in_their_folder(name: str, text: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        unpacked(f'[files]\n"{name}" = {text}\n', tmp_path / "field.wire", tmp_path / "play")
    assert said in str(caught.value)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
async def test_an_edited_profile_begins_another_file(tmp_path: Path) -> None:
    line = RtuLine({1: M7015(lambda: [20.0] * 6)})
    file = machine(tmp_path, await line.start())
    profile, wire = file.parent / "modbus" / "mine.toml", tmp_path / "field.wire"
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "gateway", "run", str(file), "--record", str(wire)), stderr=asyncio.subprocess.PIPE
    )
    try:
        async with asyncio.timeout(60):
            await until(lambda: " < 01" in text_of(wire))
            profile.write_text(profile.read_text(encoding="utf-8").replace("scale = 0.1", "scale = 0.2"))
            process.send_signal(signal.SIGHUP)
            await until(lambda: "scale = 0.2" in text_of(wire))
            process.send_signal(signal.SIGTERM)
            _, err = await process.communicate()
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
        await line.stop()
    assert process.returncode == 0, err.decode()
    assert "scale = 0.1" in read_wire_log(tmp_path / "field.wire.1").config
