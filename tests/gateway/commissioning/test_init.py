"""`talc-gateway init`, typed at or with a file of answers, with a device on this computer."""

import asyncio
import re
import shlex
import shutil
import sys
from collections.abc import AsyncIterator, Mapping
from contextlib import AbstractContextManager, asynccontextmanager
from pathlib import Path
from shutil import copy

import pytest
from asyncua.crypto.cert_gen import setup_self_signed_certificate
from click.testing import CliRunner, Result
from cryptography.x509.oid import ExtendedKeyUsageOID

from gateway.cli.main import main
from gateway.commissioning import init as command
from gateway.commissioning.scan.first import read_answers
from gateway.commissioning.scan.ports import ScanPort
from gateway.config.file import draft, load
from gateway.runtime.clocks import RealClock
from simulators.devices import M7015, Adam6015, Cia404Node, RtuLine, SlcanAdapter, TcpHost
from simulators.nc import Activity, DayPart, EmulatedControl, LoadCase, MeanLoads, Security, User
from simulators.nc.access import APPLICATION_URI
from tests.benches.command import beside, here
from tests.benches.emulated_bench import Rigid
from tests.benches.mtconnect_agent import mtconnect_agent
from tests.benches.reference_agent import REFERENCE, served_agent
from tests.benches.started import Place, Server, started

pytestmark = [pytest.mark.simulated_time, pytest.mark.filterwarnings("ignore:datetime:DeprecationWarning")]

SEVEN = [20.0, 21.0, 22.0, 23.0, 24.0, 25.0, 26.0]


def answering(wire: Server[Place]) -> AbstractContextManager[Place]:
    """The place of devices that answer beside the command."""
    return beside(started(wire))


@asynccontextmanager
async def encrypted_control(folder: Path) -> AsyncIterator[str]:
    """A SINUMERIK that accepts only the owner of gateway.der and the user talc; its URL.

    Makes the files that the first configuration names, as its lines to be confirmed ask.
    """
    usage = [ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH]
    for name, uri in (("gateway", "urn:talc:gateway"), ("control", APPLICATION_URI)):
        await setup_self_signed_certificate(
            folder / f"{name}_key.pem", folder / f"{name}.der", uri, "localhost", usage, {"commonName": name}
        )
    for name, text in (("nc-password", "secret\n"), ("gateway_key.pem", "")):
        with (folder / name).open("a", encoding="utf-8") as file:
            file.write(text)
        (folder / name).chmod(0o600)
    control = EmulatedControl(
        Rigid(), RealClock(), LoadCase([DayPart(0.0, 1e9, Activity.FINISHING, MeanLoads(x=60.0, spindle=8000.0))]),
        users={"talc": User("secret")},
        security=Security(folder / "control.der", folder / "control_key.pem", (folder / "gateway.der",)),
    )  # fmt: skip
    async with started(control) as url:
        yield url
    await asyncio.get_running_loop().shutdown_default_executor()


class Holding:
    """A Modbus unit that no supplied profile fits: a few holding registers from 0 on."""

    silent = False

    def __init__(self, *registers: int) -> None:
        self._registers = dict(enumerate(registers))

    def memory(self, function: int) -> Mapping[int, int]:
        return self._registers if function == 3 else {}


@asynccontextmanager
async def adapter_with(node: Cia404Node) -> AsyncIterator[str]:
    adapter = SlcanAdapter([node], bitrate=250_000)
    node.start(adapter.send)
    try:
        yield await adapter.start()
    finally:
        node.stop()
        await adapter.stop()


def module() -> TcpHost:
    return TcpHost({1: Adam6015(lambda: SEVEN)})


@pytest.fixture(autouse=True)
def _no_ports(monkeypatch: pytest.MonkeyPatch) -> None:
    """Hide this computer's own ports from the tests."""
    monkeypatch.setattr(command, "find_ports", list[ScanPort])


def init(*arguments: str, typed: str = "") -> Result:
    return CliRunner().invoke(main, ["init", *arguments], input=typed)


def test_typed_answers_make_a_configuration_that_check_accepts(tmp_path: Path) -> None:
    file = tmp_path / "gateway.toml"
    with answering(module()) as port:
        done = init(str(file), typed=f"mill 7\nmill_7\n\n127.0.0.1:{port}\n\nsinumerik\n\n\n\n")
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
    checked = CliRunner().invoke(main, ["check", str(file)])
    assert checked.exit_code == 0
    lines = [str(number) for number, line in enumerate(file.read_text("utf-8").splitlines(), 1) if "CONFIRM:" in line]
    assert f"still to confirm: 14 (line {', '.join(lines)})\n" in checked.output
    file.write_text(file.read_text(encoding="utf-8").replace("CONFIRM: ", ""), encoding="utf-8")
    assert "confirm" not in CliRunner().invoke(main, ["check", str(file)]).output


@pytest.mark.parametrize(
    ("answers", "said"),
    [
        ('hosts = ["127.0.0.1:99999"]', "'127.0.0.1:99999': expected a port of 1 to 65535"),
        ('hosts = ["127.0.0.1:0"]', "'127.0.0.1:0': expected a port of 1 to 65535"),
        ('[control]\nkind = "sinumerik"\nurl = "192.168.1.1"', "'192.168.1.1': expected opc.tcp://host:port"),
        ('hosts = ["http://adam"]', "hosts number 1: 'http://adam': expected a port of 1 to 65535"),
        ('hosts = ["adam/6015"]', "hosts number 1: 'adam/6015': expected the name or address of a host, or host:port"),
        ('serial = ["socket://127.0.0.1:4001"]', "serial number 1: 'socket://127.0.0.1:4001': expected the path of a "
         "serial port; for a device server: talc-gateway scan tcp --rtu HOST:PORT"),
        ('serial = ["http://x:1"]', "serial number 1: 'http://x:1': expected the path of a serial port"),
        ('serial = ["/dev/null", ""]', "serial number 2: '': expected the path of a serial port"),
        ('can = ["can0", "can 1"]', "'can 1': expected the system's name of a CAN interface, such as can0"),
    ],
)  # fmt: skip
def test_an_answer_that_leads_nowhere_is_refused_before_anything_is_scanned(
    answers: str, said: str, tmp_path: Path
) -> None:
    (tmp_path / "answers.toml").write_text(f'machine = "mill"\n{answers}\n', encoding="utf-8")
    done = here("init", str(tmp_path / "gateway.toml"), "--answers", str(tmp_path / "answers.toml"))
    assert done.code == 2
    assert said in done.err
    assert done.err.count("answers.toml: ") == 1
    assert "requests" not in done.together


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
        done = init(str(file), typed=f"mill\n\n127.0.0.1:{port}\n\nmtconnect\n{url}\n\n")
        assert done.exit_code == 0, done.output
        assert CliRunner().invoke(main, ["check", str(file)]).exit_code == 0
        probed = CliRunner().invoke(main, ["probe", str(file)])
    assert f"{url} describes X, Y, Z, A, C, spindle_speed, speed_X, speed_C, mode" in done.output
    assert "17 of 17 good" in probed.output, "7 temperatures, 5 positions, 3 states, mode and program"
    assert probed.exit_code == 0


def run_on(file: Path, name: str) -> Result:
    return CliRunner().invoke(main, [name, str(file)], env={"COLUMNS": "200"})


@pytest.mark.slow
def test_probe_reads_a_sinumerik_with_what_was_written_once_its_files_are_there(tmp_path: Path) -> None:
    """Encrypted, with user and certificates; nothing of the written text is changed."""
    file = tmp_path / "gateway.toml"
    with answering(module()) as port, beside(encrypted_control(tmp_path)) as url:
        done = init(str(file), typed=f"mill\n\n127.0.0.1:{port}\n\nsinumerik\n{url}\ntalc\n{tmp_path}\n")
        assert done.exit_code == 0, done.output
        checked, probed = run_on(file, "check"), run_on(file, "probe")
        (tmp_path / "nc-password").write_text("wrong\n", encoding="utf-8")
        refused = run_on(file, "probe")
    assert (checked.exit_code, "warning" in checked.output) == (0, False), checked.output
    assert "7 channels, 6 machine states; compensation monitor, probing not armed" in checked.output
    assert re.search(r"spindle_speed │ 8000\.000", probed.output), probed.output
    assert "21 of 21 good" in probed.output, "7 temperatures, 5 positions, 6 states, mode, program and tool"
    assert probed.exit_code == 0
    assert refused.exit_code == 3
    assert "refuses user 'talc'" in refused.output


@pytest.mark.parametrize("kind", ["linuxcnc", "agent"])
def test_probe_reads_an_agent_with_what_was_written_once_its_key_is_there(tmp_path: Path, kind: str) -> None:
    """Only the port differs from the usual one, which another program on this computer may use."""
    file = tmp_path / "gateway.toml"
    with answering(module()) as port, beside(served_agent(REFERENCE.Machine())) as agent:
        done = init(str(file), typed=f"mill\n\n127.0.0.1:{port}\n\n{kind}\n127.0.0.1\n{agent.key_file(tmp_path)}\n")
        assert done.exit_code == 0, done.output
        text = file.read_text(encoding="utf-8").replace("\nkey_file", f"\nport = {agent.port}\nkey_file")
        file.write_text(text, encoding="utf-8")
        checked, probed = run_on(file, "check"), run_on(file, "probe")
        (tmp_path / "agent.key").write_text("f" * 32, encoding="utf-8")
        refused = run_on(file, "probe")
    assert (checked.exit_code, "warning" in checked.output) == (0, False), checked.output
    assert "22 of 22 good" in probed.output, "7 temperatures, 5 positions, 6 states, mode, program, tool and probe"
    assert probed.exit_code == 0
    assert refused.exit_code == 3
    assert "the proof does not fit" in refused.output


def test_an_mtconnect_agent_that_is_silent_leaves_placeholders(tmp_path: Path) -> None:
    file, answers = tmp_path / "gateway.toml", tmp_path / "answers.toml"
    with answering(module()) as port:
        control = '[control]\nkind = "mtconnect"\nurl = "http://127.0.0.1:9"\n'
        answers.write_text(f'machine = "mill"\nhosts = ["127.0.0.1:{port}"]\n{control}', encoding="utf-8")
        done = init(str(file), "--answers", str(answers))
    assert done.exit_code == 0, done.output
    assert "its data items are placeholders" in done.output
    assert CliRunner().invoke(main, ["check", str(file)]).exit_code == 0


def test_a_wire_that_cannot_be_opened_is_reported_and_no_answer_is_lost(tmp_path: Path) -> None:
    file, answers = tmp_path / "gateway.toml", tmp_path / "answers.toml"
    answers.write_text(
        'machine = "mill"\nserial = ["/dev/absent"]\nhosts = ["127.0.0.1:9"]\n[control]\nkind = "sinumerik"\n',
        encoding="utf-8",
    )
    done = init(str(file), "--answers", str(answers))
    assert done.exit_code == 3
    assert "/dev/absent" in done.output
    assert "no device was recognised" in done.output
    begun = draft(file.read_text(encoding="utf-8"), file)
    assert (begun.machine.name, begun.devices, begun.nc is not None) == ("mill", (), True)
    assert read_answers(file.with_suffix(".answers.toml")) == read_answers(answers)


def test_two_unknown_modules_become_devices_without_an_edit(tmp_path: Path) -> None:
    """Each is written as comments with the command that drafts its profile, which init then asks for."""
    file = tmp_path / "gateway.toml"
    with answering(TcpHost({3: Holding(215, 220), 255: Holding(9, 8, 7), 9: Adam6015(lambda: SEVEN)})) as port:
        typed = f"mill\n\n127.0.0.1:{port}\n3-9,255\nlinuxcnc\n\n\n"
        first = init(str(file), typed=typed + "\n\n")
        assert first.exit_code == 0, first.output
        assert [device.unit for device in load(file).devices] == [9]
        text = file.read_text(encoding="utf-8")
        commands = re.findall(r"^# next: talc-gateway (.*)$", text, re.MULTILINE)
        scanned = CliRunner().invoke(main, ["scan", "tcp", f"127.0.0.1:{port}", "--units", "3,255"])
        assert [line for line in scanned.output.splitlines() if "inspect" in line] == [
            f"next: talc-gateway {command}" for command in commands
        ]
        file.write_text(text.replace("rtd1_in0", "bed_front"), encoding="utf-8")
        drafts: list[str] = []
        home = tmp_path / "home"  # which the service cannot read
        home.mkdir()
        for command, folder in zip(commands, (tmp_path, home), strict=True):
            words = shlex.split(command)
            words[-1] = str(folder / words[-1])
            assert CliRunner().invoke(main, words).exit_code == 0
            drafts.append(words[-1])
        again = init(str(file), typed="\n" * 7 + f"absent.toml\n{drafts[0]}\n{drafts[1]}\n")
        assert again.exit_code == 0, again.output
        assert "absent.toml" in again.output, "and asked again"
        shutil.rmtree(home)
        config = load(file)
        assert {(d.unit, len(d.channels)) for d in config.devices} == {(9, 7), (3, 2), (255, 3)}
        assert "bed_front" in config.input_names, "what a person has named stays"
        assert config.nc is not None
        assert "unknown" not in file.read_text(encoding="utf-8")
        settled = file.read_text(encoding="utf-8")
        assert init(str(file), typed="\n" * 7).exit_code == 0
        assert file.read_text(encoding="utf-8") == settled
        assert "12 of" in CliRunner().invoke(main, ["probe", str(file)]).output


def test_a_node_on_a_serial_can_adapter_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "gateway.toml"
    with beside(adapter_with(Cia404Node(5, lambda: SEVEN[:2], inputs=2, vendor="esd", heartbeat_ms=20))) as port:
        monkeypatch.setattr(command, "find_ports", lambda: [ScanPort("serial", port, "an adapter")])
        done = init(str(file), typed="mill\n\nslcan\n\nnone\n")
    assert done.exit_code == 0, done.output
    (bus,), (device,) = load(file).buses, load(file).devices
    assert (bus.kind, bus.model_dump()["interface"], device.profile) == ("canopen", "slcan", "cia404")


def test_answers_before_the_input_ended_are_proposed_again(tmp_path: Path) -> None:
    file = tmp_path / "gateway.toml"
    done = init(str(file), typed="mill_9\n\n10.0.0.9:77777\n10.0.0.9:502\n")
    assert done.exit_code == 1
    assert "expected a port of 1 to 65535" in done.output, "and asked again"
    assert not file.exists()
    kept = read_answers(file.with_suffix(".answers.toml"))
    assert (kept.machine, kept.hosts) == ("mill_9", ("10.0.0.9:502",))


def test_a_file_that_exists_is_not_touched(tmp_path: Path) -> None:
    file = tmp_path / "gateway.toml"
    file.write_text("mine", encoding="utf-8")
    done = init(str(file), typed="mill\n")
    assert done.exit_code == 2
    assert "adds devices to it" in done.output
    assert file.read_text(encoding="utf-8") == "mine"


def test_the_untouched_example_of_the_package_is_replaced_and_an_edited_one_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    example = Path(__file__).parents[3] / "deploy" / "debian" / "gateway.toml"
    (tmp_path / "share").mkdir()
    copy(example, tmp_path / "share")
    monkeypatch.setattr(sys, "prefix", str(tmp_path))  # of the package: /opt/talc-gateway
    file = tmp_path / "gateway.toml"
    with answering(module()) as port:
        file.write_text(example.read_text(encoding="utf-8").replace("mill", "mine"), encoding="utf-8")
        assert init(str(file), typed="mill\n").exit_code == 2
        assert '"mine"' in file.read_text(encoding="utf-8")
        copy(example, file)
        file.chmod(0o640)
        done = init(str(file), typed=f"mill\n\n127.0.0.1:{port}\n\nnone\n")
    assert done.exit_code == 0, done.output
    assert [d.profile for d in load(file).devices] == ["advantech_adam6015"]
    assert file.stat().st_mode & 0o777 == 0o640


def test_a_folder_that_cannot_be_written_is_reported_before_anything_is_asked(tmp_path: Path) -> None:
    done = init(str(tmp_path / "absent" / "gateway.toml"), typed="mill\n")
    assert done.exit_code == 2
    assert "does it exist, and may you write there?" in done.output
    assert "Name of the machine" not in done.output


def test_a_serial_line_is_scanned_at_the_usual_speeds_and_an_absent_can_interface_is_reported(tmp_path: Path) -> None:
    file, answers = tmp_path / "gateway.toml", tmp_path / "answers.toml"
    with answering(RtuLine({7: M7015(lambda: SEVEN[:6])}, baud=19200)) as port:
        answers.write_text(f'machine = "mill"\nserial = ["{port}", "{port}"]\ncan = ["absent0"]\n', encoding="utf-8")
        done = init(str(file), "--answers", str(answers))
    assert done.exit_code == 0, done.output
    assert "absent0: " in done.output
    assert done.output.count(f"{port}: at most") == 1, "named twice, and scanned once"
    (device,) = load(file).devices
    assert (device.unit, device.profile) == (7, "icpdas_m7015")
    (bus,) = load(file).buses
    assert bus.model_dump()["baud"] == 19200
