"""`record` and `play` name buses whose traffic the wire log does not contain, and say what to do."""

from datetime import UTC, datetime
from pathlib import Path

from click.testing import CliRunner, Result

from gateway.acquisition.wire_log import WireLogWriter, not_recorded
from gateway.cli.main import main
from gateway.config.file import load
from gateway.config.packed import packed_toml

SERVER = """[machine]
name = "mill"
[[bus]]
name = "hall"
kind = "opcua"
url = "opc.tcp://127.0.0.1:1"
security = "none"
[[device]]
name = "sensors"
bus = "hall"
profile = "hall.toml"
unit = 1
channels = { north = 0 }
"""
AGENT = """[[bus]]
name = "nc1"
kind = "agent"
key_file = "talc.key"
[[device]]
name = "drives"
bus = "nc1"
profile = "drives.toml"
unit = 1
channels = { motor_x = 0 }
"""
VALUES = 'protocol = "agent"\ntitle = "drives"\nunit = "degC"\n[[value]]\nname = "drive-x.temperature"\n'
PROFILE = 'protocol = "opcua"\ntitle = "hall"\nunit = "degC"\n[[node]]\nnode = "ns=1;s=north"\n'
LINE = """[[bus]]
name = "rtu1"
kind = "modbus_rtu"
port = "/dev/serial/by-id/absent"
[[device]]
name = "rtd1"
bus = "rtu1"
profile = "icpdas_m7015"
unit = 1
channels = { bed = 0 }
"""


def config(folder: Path, text: str) -> Path:
    (folder / "hall.toml").write_text(PROFILE)
    (folder / "drives.toml").write_text(VALUES)
    path = folder / "gateway.toml"
    path.write_text(text)
    return path


def run(*words: object) -> Result:
    return CliRunner().invoke(main, [str(word) for word in words], env={"COLUMNS": "200"})


def test_a_configuration_with_nothing_to_record_is_refused(tmp_path: Path) -> None:
    answer = run("record", config(tmp_path, SERVER), "-o", tmp_path / "field.wire")
    assert answer.exit_code == 2
    assert "there is nothing to record" in answer.output
    assert "bus 'hall' (opcua): the traffic of an OPC UA session is not recorded; db export, or a" in answer.output
    assert not (tmp_path / "field.wire").exists()


def test_beside_other_buses_they_are_named(tmp_path: Path) -> None:
    hall, drives = not_recorded(load(config(tmp_path, SERVER + LINE + AGENT)))
    assert "bus 'hall' (opcua)" in hall
    assert "db export" in hall
    assert "bus 'nc1' (agent): the traffic of a control's agent, which is signed, is not recorded; db export" in drives


def test_play_says_why_they_are_absent(tmp_path: Path) -> None:
    packed, path = packed_toml(load(config(tmp_path, SERVER + LINE + AGENT))), tmp_path / "field.wire"
    with WireLogWriter(path, packed, datetime.now(UTC), most_bytes=1_000_000):
        pass
    answer = run("play", path, "--seconds", 0.1)
    assert answer.exit_code == 0, answer.output
    assert "hall (opcua): is never recorded, so it is absent now" in answer.output
    assert "nc1 (agent): is never recorded, so it is absent now" in answer.output
    assert "rtu1 (modbus_rtu): did not open while recording, so it is absent now" in answer.output


def test_play_puts_its_configuration_there_whole(tmp_path: Path) -> None:
    """A script that waits for the file never finds a part of it: the file is exchanged, not written into."""
    packed, path = packed_toml(load(config(tmp_path, LINE + '[machine]\nname = "mill"\n'))), tmp_path / "field.wire"
    with WireLogWriter(path, packed, datetime.now(UTC), most_bytes=1_000_000):
        pass
    shown = tmp_path / "play" / "gateway.toml"
    shown.parent.mkdir()
    shown.write_text("of an earlier recording", encoding="utf-8")
    (tmp_path / "former").hardlink_to(shown)
    assert run("play", path, "--folder", shown.parent, "--seconds", 0.1).exit_code == 0
    assert (tmp_path / "former").read_text(encoding="utf-8") == "of an earlier recording"
    assert "rtd1" in shown.read_text(encoding="utf-8")
    assert not list(shown.parent.glob("*.part"))
