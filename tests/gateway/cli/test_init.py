"""`talc-gateway init`, typed at or with a file of answers, with a device on this computer."""

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Thread

import pytest
from click.testing import CliRunner, Result

from gateway.cli import init as command
from gateway.cli import main
from gateway.config import load
from gateway.scan import ScanPort
from simulators.devices import M7015, Adam6015, RtuLine, TcpHost
from tests.benches.mtconnect_agent import mtconnect_agent

pytestmark = [pytest.mark.simulated_time, pytest.mark.filterwarnings("ignore:datetime:DeprecationWarning")]

SEVEN = [20.0, 21.0, 22.0, 23.0, 24.0, 25.0, 26.0]


@contextmanager
def answering(wire: TcpHost | RtuLine) -> Iterator[int | str]:
    """The place of devices that answer on another thread: the command has an event loop of its own."""
    listening, done, places = Event(), Event(), list[int | str]()

    async def serve() -> None:
        places.append(await wire.start())
        listening.set()
        await asyncio.to_thread(done.wait)
        await wire.stop()

    thread = Thread(target=lambda: asyncio.run(serve()))
    thread.start()
    listening.wait()
    try:
        yield places[0]
    finally:
        done.set()
        thread.join()


def module() -> TcpHost:
    return TcpHost({1: Adam6015(lambda: SEVEN)})


@pytest.fixture(autouse=True)
def _no_ports(monkeypatch: pytest.MonkeyPatch) -> None:
    """This computer's own ports are none of the tests' business."""
    monkeypatch.setattr(command, "find_ports", list[ScanPort])


def init(*arguments: str, typed: str = "") -> Result:
    return CliRunner().invoke(main, ["init", *arguments], input=typed)


def test_typed_answers_make_a_configuration_that_check_accepts(tmp_path: Path) -> None:
    file = tmp_path / "gateway.toml"
    with answering(module()) as port:
        done = init(str(file), typed=f"mill 7\nmill_7\n127.0.0.1:{port}\nsinumerik\n\n\n\n")
    assert done.exit_code == 0, done.output
    assert "expected a letter, then letters, digits" in done.output, "and asked again"
    assert "1 answered, 1 recognised" in done.output
    config = load(file)
    assert (config.machine.name, [d.profile for d in config.devices]) == ("mill_7", ["advantech_adam6015"])
    assert config.nc is not None
    assert config.nc.address == "opc.tcp://192.168.214.1:4840"
    assert not config.probing.armed
    assert "14 lines to confirm" in done.output
    for number, line in enumerate(file.read_text(encoding="utf-8").splitlines(), start=1):
        assert ("CONFIRM:" in line) == (f"  line {number}: " in done.output)
    assert CliRunner().invoke(main, ["check", str(file)]).exit_code == 0


def test_a_file_of_answers_asks_nothing(tmp_path: Path) -> None:
    file, answers = tmp_path / "gateway.toml", tmp_path / "answers.toml"
    with answering(module()) as port:
        answers.write_text(
            f'machine = "router"\nhosts = ["127.0.0.1:{port}"]\n[control]\nkind = "linuxcnc"\n', encoding="utf-8"
        )
        done = init(str(file), "--answers", str(answers))
    assert done.exit_code == 0, done.output
    config = load(file)
    assert config.nc is not None
    assert config.nc.kind == "linuxcnc"
    assert len(config.devices) == 1


def test_an_mtconnect_agent_is_asked_for_its_data_items_and_probe_reads_them(tmp_path: Path) -> None:
    file = tmp_path / "gateway.toml"
    with answering(module()) as port, mtconnect_agent(tmp_path) as (agent, url):
        for item in ("Xpos", "Ypos", "Zpos", "Apos", "Cpos", "Srpm", "Xfrt", "Cfrt"):
            agent.push_data(item, 12.5)
        done = init(str(file), typed=f"mill\n127.0.0.1:{port}\nmtconnect\n{url}\n\n")
        assert done.exit_code == 0, done.output
        assert CliRunner().invoke(main, ["check", str(file)]).exit_code == 0
        probed = CliRunner().invoke(main, ["probe", str(file)])
    assert f"{url} describes X, Y, Z, A, C, spindle_speed, speed_X, speed_C, mode" in done.output
    assert "17 of 17 good" in probed.output, "7 temperatures, 5 positions, 3 states, mode and program"
    assert probed.exit_code == 0


def test_an_mtconnect_agent_that_is_silent_leaves_placeholders(tmp_path: Path) -> None:
    file, answers = tmp_path / "gateway.toml", tmp_path / "answers.toml"
    with answering(module()) as port:
        control = '[control]\nkind = "mtconnect"\nurl = "http://127.0.0.1:9"\n'
        answers.write_text(f'machine = "mill"\nhosts = ["127.0.0.1:{port}"]\n{control}', encoding="utf-8")
        done = init(str(file), "--answers", str(answers))
    assert done.exit_code == 0, done.output
    assert "its data items are placeholders" in done.output
    assert CliRunner().invoke(main, ["check", str(file)]).exit_code == 0


def test_a_wire_that_cannot_be_opened_is_told_and_nothing_is_written(tmp_path: Path) -> None:
    file, answers = tmp_path / "gateway.toml", tmp_path / "answers.toml"
    answers.write_text('machine = "mill"\nserial = ["/dev/absent"]\nhosts = ["127.0.0.1:9"]\n', encoding="utf-8")
    done = init(str(file), "--answers", str(answers))
    assert done.exit_code == 3
    assert "/dev/absent" in done.output
    assert "no device was recognised" in done.output
    assert not file.exists()


def test_a_file_that_exists_is_not_touched(tmp_path: Path) -> None:
    file = tmp_path / "gateway.toml"
    file.write_text("mine", encoding="utf-8")
    done = init(str(file), typed="mill\n")
    assert done.exit_code == 2
    assert "adds devices to it" in done.output
    assert file.read_text(encoding="utf-8") == "mine"


def test_a_serial_line_is_scanned_at_the_usual_speeds_and_an_absent_can_interface_is_told(tmp_path: Path) -> None:
    file, answers = tmp_path / "gateway.toml", tmp_path / "answers.toml"
    with answering(RtuLine({7: M7015(lambda: SEVEN[:6])}, baud=19200)) as port:
        answers.write_text(f'machine = "mill"\nserial = ["{port}"]\ncan = ["absent0"]\n', encoding="utf-8")
        done = init(str(file), "--answers", str(answers))
    assert done.exit_code == 0, done.output
    assert "absent0: " in done.output
    (device,) = load(file).devices
    assert (device.unit, device.profile) == (7, "icpdas_m7015")
    (bus,) = load(file).buses
    assert bus.model_dump()["baud"] == 19200
