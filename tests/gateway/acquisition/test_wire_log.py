"""The form of a recording, version 1: the promises of `docs/wire-log.md` about the file."""

import re
from datetime import UTC, datetime
from pathlib import Path

import can
import pytest

from gateway.acquisition.wire_log import WireLogError, WireLogWriter, read_wire_log

BEGAN = datetime(2026, 11, 23, 8, tzinfo=UTC)


def test_lines_are_as_documented(tmp_path: Path) -> None:
    file = tmp_path / "field.wire"
    with WireLogWriter(file, '[machine]\nname = "mill"', BEGAN, most_bytes=10**6) as writer:
        tap = writer.tap("rtu1")
        tap.note("open")
        tap.data(True, b"\x01\x04")
        tap.data(False, b"\xff")
        tap.note("lost the device closed\nthe connection")
    lines = file.read_text(encoding="utf-8").splitlines()
    began = lines.pop(1)
    assert re.fullmatch(r"# began 2026-11-23T08:00:0\d\.\d{3}\+00:00", began)
    assert lines[:3] == ["# talc wire log 1", "#: [machine]", '#: name = "mill"']
    assert [re.sub(r"^\(17\d{8}\.\d{6}\) ", "", line) for line in lines[3:]] == [
        "rtu1 ! open",
        "rtu1 > 0104",
        "rtu1 < ff",
        "rtu1 ! lost the device closed the connection",
    ]
    assert read_wire_log(file).config == '[machine]\nname = "mill"'


def test_can_frames_are_candump_lines_that_other_programs_read(tmp_path: Path) -> None:
    file, log = tmp_path / "field.wire", tmp_path / "can.log"
    with WireLogWriter(file, "", BEGAN, most_bytes=10**6) as writer:
        tap = writer.tap("can1")
        tap.note("open")
        tap.frame(True, 0x605, False, bytes.fromhex("4000100000000000"))
        tap.frame(False, 0x18FF0005, True, b"\x01\x02")
        writer.tap("rtu1").data(True, b"\x01\x04")
    log.write_text("".join(line for line in file.read_text().splitlines(True) if "#" in line[1:]), encoding="utf-8")
    with can.CanutilsLogReader(log) as reader:
        messages = list(reader)
    assert [(m.arbitration_id, m.is_extended_id, m.is_rx) for m in messages] == [
        (0x605, False, False),
        (0x18FF0005, True, True),
    ]
    assert abs(messages[0].timestamp - BEGAN.timestamp()) < 5
    assert [(e.identifier, e.extended, e.data) for e in read_wire_log(file).of("can1")[1:]] == [
        (0x605, False, bytes.fromhex("4000100000000000")),
        (0x18FF0005, True, b"\x01\x02"),
    ]


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "is not a recording"),
        ("# talc wire log 2\n", "is not a recording"),
        ("# talc wire log 1\nrubbish\n(1.0) a < 00\n", "line 2: cannot be read: 'rubbish'"),
        ("# talc wire log 1\n(1.0) a < 0\n(1.0) a < 00\n", "line 2"),
    ],
)
def test_what_is_not_a_recording_is_reported_with_its_line(text: str, problem: str, tmp_path: Path) -> None:
    file = tmp_path / "x.wire"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(WireLogError, match=problem):
        read_wire_log(file)


@pytest.mark.parametrize("cut", ["(2.000000) a < 010", "(2.000000) a < 01", "(2.000000) a ! op", "#: unit = 1"])
def test_line_that_a_power_failure_cut_is_left_out(cut: str, tmp_path: Path) -> None:
    """Even if the remaining part could be a whole line."""
    file = tmp_path / "x.wire"
    file.write_text(f"# talc wire log 1\n(1.000000) a < 0102\n{cut}", encoding="utf-8")
    assert read_wire_log(file).config == ""
    assert [event.data for event in read_wire_log(file).events] == [b"\x01\x02"]


def test_recording_ends_at_its_size_and_the_bus_goes_on(tmp_path: Path) -> None:
    file = tmp_path / "x.wire"
    with WireLogWriter(file, "", BEGAN, most_bytes=1000) as writer:
        tap = writer.tap("a")
        for _ in range(100):
            tap.data(True, b"0123456789")
    assert "has reached" in writer.ended
    assert file.stat().st_size <= 1000
    assert len(read_wire_log(file).events) == writer.counts["a"] > 5


def test_full_disk_ends_the_recording_only() -> None:
    with WireLogWriter(Path("/dev/full"), "", BEGAN, most_bytes=10**6) as writer:
        writer.tap("a").data(True, b"x")
    assert writer.ended == "/dev/full: No space left on device"


def test_recording_that_rotates_keeps_the_last_two_files(tmp_path: Path) -> None:
    file = tmp_path / "x.wire"
    with WireLogWriter(file, '[machine]\nname = "mill"', BEGAN, most_bytes=1000, rotate=True) as writer:
        tap = writer.tap("a")
        for turn in range(100):
            tap.data(True, turn.to_bytes(2, "big"))
    last, before = read_wire_log(file), read_wire_log(tmp_path / "x.wire.1")
    numbers = [int.from_bytes(event.data, "big") for event in (*before.events, *last.events)]
    assert numbers == list(range(100 - len(numbers), 100))
    assert len(numbers) > 20
    assert last.config == before.config == '[machine]\nname = "mill"'
    assert sorted(path.name for path in tmp_path.iterdir()) == ["x.wire", "x.wire.1"]
    assert writer.ended == ""


def test_another_configuration_begins_another_file(tmp_path: Path) -> None:
    file = tmp_path / "x.wire"
    with WireLogWriter(file, "a = 1", BEGAN, most_bytes=10**6) as writer:
        writer.tap("a").data(True, b"old")
        writer.reconfigure("b = 2")
        writer.tap("a").data(True, b"new")
    now, before = read_wire_log(file), read_wire_log(tmp_path / "x.wire.1")
    assert (before.config, [e.data for e in before.events]) == ("a = 1", [b"old"])
    assert (now.config, [e.data for e in now.events]) == ("b = 2", [b"new"])
