"""`record` and `play` as commands, and CAN logs of other programs."""

import asyncio
import re
import signal
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import can
import pytest

from gateway.acquisition.wire_log import read_wire_log
from gateway.demo.play import playing, read_wire_recording
from simulators.devices import M7015, Cia404Node, RtuLine, SlcanAdapter
from simulators.devices.can_logger import CanLogger
from simulators.devices.source import SensorFault
from tests.benches.command import beside, here, talc_gateway
from tests.benches.file_waits import appears, text_of
from tests.benches.service_file import UNPUBLISHED, m7015, rtu_bus
from tests.benches.waits import until

FRAMES = CanLogger(lambda: [20.0, -3.3, 40.0, 99.9, 22.2], lambda _: None).frames()


def write_trace(file: Path) -> None:
    """What another program wrote: plain CAN, three cycles."""
    with can.Logger(file) as writer:
        for turn in range(3):
            for number, data in FRAMES:
                at_s = 1000.0 + turn / 10
                writer(can.Message(timestamp=at_s, arbitration_id=number, data=data, is_extended_id=False))


@pytest.mark.parametrize("name", ["trace.log", "trace.asc", "trace.blf", "trace.trc"])
def test_can_logs_of_other_programs_are_read(name: str, tmp_path: Path) -> None:
    write_trace(tmp_path / name)
    config, events = read_wire_recording(tmp_path / name, tmp_path)
    assert config is None
    assert [(event.identifier, event.data) for event in events] == FRAMES * 3


@pytest.mark.slow
async def test_plain_can_log_is_played(tmp_path: Path) -> None:
    write_trace(tmp_path / "trace.log")
    arguments = ("play", str(tmp_path / "trace.log"), "--folder", str(tmp_path))
    enough = asyncio.Event()
    player = asyncio.create_task(talc_gateway(*arguments, interrupt=enough.wait))
    link = tmp_path / "can1"
    await appears(link, player)
    bus = await asyncio.to_thread(can.Bus, interface="slcan", channel=str(link), sleep_after_open=0)
    try:
        seen: set[tuple[int, bytes]] = set()
        async with asyncio.timeout(60.0):
            while seen != set(FRAMES):
                message = await asyncio.to_thread(bus.recv, 0.5)
                if message is not None:
                    seen.add((message.arbitration_id, bytes(message.data)))
    finally:
        bus.shutdown()
        enough.set()
    assert 'kind = "can"' in (await player).out


CONFIG = """[machine]
name = "mill"
[[bus]]
name = "rtu1"
kind = "modbus_rtu"
port = "{rtu}"
period_s = 0.2
timeout_s = 1.0
[[bus]]
name = "can1"
kind = "canopen"
interface = "slcan"
channel = "{can}"
period_s = 0.2
[[bus]]
name = "gone1"
kind = "me_rs485"
port = "{gone}"
[[device]]
name = "rtd1"
bus = "rtu1"
profile = "icpdas_m7015"
unit = 1
channels = {{ bed = 0, column = 4 }}
[[device]]
name = "rtd2"
bus = "rtu1"
profile = "icpdas_m7015"
unit = 2
channels = {{ slide = 0 }}
[[device]]
name = "fluids"
bus = "can1"
profile = "cia404"
unit = 5
options = {{ vendor = "jumo" }}
channels = {{ coolant = 0 }}
[[device]]
name = "eddy"
bus = "gone1"
profile = "me_rs485"
unit = 126
options = {{ range_um = 500.0 }}
channels = {{ growth = 0 }}
"""


@asynccontextmanager
async def recorded_site(folder: Path) -> AsyncIterator[Path]:
    """A site with a broken sensor, a silent unit, and an absent port; yields its configuration."""
    broken, silent = M7015(lambda: [20.0] * 6), M7015(lambda: [20.0] * 6)
    broken.faults.set(4, SensorFault.OPEN)
    silent.faults.silent = True
    line, node = RtuLine({1: broken, 2: silent}), Cia404Node(5, lambda: [30.0], inputs=1)
    adapter = SlcanAdapter([node])
    file = folder / "gateway.toml"
    ports = {"rtu": await line.start(), "can": await adapter.start(), "gone": f"{folder}/absent"}
    file.write_text(CONFIG.format(**ports), encoding="utf-8")
    try:
        yield file
    finally:
        await line.stop()
        await adapter.stop()


@pytest.mark.slow
@pytest.mark.simulated_time
def test_commands_record_play_and_probe_alike(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wire, folder = tmp_path / "field.wire", tmp_path / "played"
    with beside(recorded_site(tmp_path)) as file:
        before = here("probe", str(file))
        recorded = here("record", str(file), "-o", str(wire), "--seconds", "8")
    assert recorded.code == 0, recorded.err
    folder.mkdir()
    config = folder / "gateway.toml"
    with beside(playing(*read_wire_recording(wire, folder), folder)):
        after = here("probe", str(config))
    assert "gone1 (me_rs485): did not open" in capsys.readouterr().out
    assert _without_times(after.out, tmp_path) == _without_times(before.out, tmp_path)
    assert after.code == before.code == 3
    assert not list(config.parent.glob("*1"))  # the links go with the devices


def _without_times(table: str, folder: Path) -> str:
    """Without latencies, how long an answer was waited for, ports' names and the padding that their width makes."""
    timeless = re.sub(r"[\d.]+ (ms|s)\b", "", table.replace(str(folder), ""))
    text = re.sub(r"\S*(absent|gone1)(?=[ :'])", "PORT", timeless)
    return re.sub(r"[ ━─]+", " ", text)


def test_existing_recording_is_not_overwritten(tmp_path: Path) -> None:
    config, file = tmp_path / "gateway.toml", tmp_path / "field.wire"
    config.write_text(CONFIG.format(rtu="/dev/a", can="/dev/b", gone="/dev/c"), encoding="utf-8")
    file.write_text("what happened last night", encoding="utf-8")
    done = here("record", str(config), "-o", str(file))
    assert done.code == 2
    assert "recordings are not overwritten" in done.err
    assert file.read_text(encoding="utf-8") == "what happened last night"


@pytest.mark.slow
async def test_service_keeps_what_passed_across_a_reload(tmp_path: Path) -> None:
    """A wrong unit id is corrected while the gateway runs: each file contains what was configured at that time."""
    config, wire = tmp_path / "gateway.toml", tmp_path / "field.wire"
    wire.write_text("of an earlier run", encoding="utf-8")
    line = RtuLine({2: M7015(lambda: [20.0] * 6)})
    bus = UNPUBLISHED + rtu_bus(await line.start(), "period_s = 0.05\ntimeout_s = 0.5")
    config.write_text(bus + m7015(unit=1), encoding="utf-8")
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "gateway", "run", str(config), "--record", str(wire)), stderr=asyncio.subprocess.PIPE
    )
    try:
        async with asyncio.timeout(120):
            await until(lambda: " > 01" in text_of(wire))
            config.write_text(bus + m7015(unit=2), encoding="utf-8")
            process.send_signal(signal.SIGHUP)
            await until(lambda: text_of(wire).count(" < 02") >= 3)
            process.send_signal(signal.SIGTERM)
            _, err = await process.communicate()
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
        await line.stop()
    assert process.returncode == 0, err.decode()
    now, before = read_wire_log(wire), read_wire_log(tmp_path / "field.wire.1")
    assert ("unit = 1" in before.config, "unit = 2" in now.config) == (True, True)
    assert {event.data[0] for event in before.events if event.passed == "sent"} == {1}
    assert {event.data[0] for event in now.events if event.passed == "received"} == {2}


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("notes.txt", "is not a recording"),
        ("trace.asc", "contains no CAN frames"),
        ("trace.blf", "cannot be read as a CAN log"),
    ],
)
async def test_file_that_is_not_a_recording_is_refused_in_words(name: str, said: str, tmp_path: Path) -> None:
    file = tmp_path / name
    file.write_text("bought milk\n", encoding="utf-8")
    # python-can does not close a BLF file that it cannot read; the process does.
    done = await talc_gateway("play", str(file)) if file.suffix == ".blf" else here("play", str(file))
    assert done.code == 2
    assert done.err.startswith(f"error: {file}")
    assert said in done.err.splitlines()[0]
    assert not file.with_name(f"{name}.play").exists()


@pytest.mark.parametrize("group", ["10.0.0.1:43113", "239.74.163.2", "239.74.163.2:0", "can0:43113"])
def test_invalid_group_is_refused(group: str) -> None:
    done = here("play", "docs/example.wire", "--multicast", group)
    assert done.code == 2
    assert "--multicast" in done.err
    assert f"{group}: expected GROUP:PORT" in done.err


def test_a_recording_in_which_nothing_could_be_read_is_not_a_success(tmp_path: Path) -> None:
    """It is kept nevertheless: it shows that nobody answers."""
    config, wire = tmp_path / "gateway.toml", tmp_path / "field.wire"
    config.write_text(CONFIG.format(rtu="absent1", can="absent2", gone="absent3"), encoding="utf-8")
    done = here("record", str(config), "-o", str(wire), "--seconds", "0.3")
    assert done.code == 3
    assert "nothing could be read" in done.err
    assert wire.exists()


@pytest.mark.slow
async def test_a_second_play_of_one_file_leaves_the_first_ones_links(tmp_path: Path) -> None:
    write_trace(tmp_path / "trace.log")
    arguments = ("play", str(tmp_path / "trace.log"))
    link, enough = tmp_path / "trace.log.play" / "can1", asyncio.Event()
    player = asyncio.create_task(talc_gateway(*arguments, interrupt=enough.wait))
    await appears(link, player)
    target = link.readlink()
    second = here(*arguments)
    assert second.code == 3
    assert "another `play` uses this folder; stop it, or give another --folder" in second.err
    assert link.readlink() == target
    enough.set()
    assert (await player).code == 0
    assert not link.is_symlink()
