"""Whatever a recording contains, and wherever a power failure cut it: its events, or an error with its line."""

import re
from datetime import UTC, datetime
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.acquisition.wire_log import WireEvent, WireLogError, WireLogWriter, read_wire_log

BEGAN = datetime(2026, 11, 23, 8, tzinfo=UTC)
FIRST = b"# talc wire log 1\n"
DATA = st.binary(max_size=12)
CALL = st.one_of(
    st.tuples(st.just("data"), st.booleans(), DATA),
    st.tuples(st.just("frame"), st.booleans(), st.integers(0, 0x7FF), st.just(False), DATA),
    st.tuples(st.just("frame"), st.booleans(), st.integers(0, 0x1FFFFFFF), st.just(True), DATA),
    st.tuples(st.just("note"), st.text(min_size=1, max_size=20)),
)
CONFIG = st.lists(st.text(st.characters(codec="utf-8", exclude_characters="\r\n"), max_size=20), max_size=4)
LINE = st.one_of(
    st.binary(max_size=40),
    st.from_regex(r"\(\d+\.\d+\) \w+ ([<>] [0-9a-f]*|! .*|([0-9A-F]{3}|[0-9A-F]{8})#[0-9A-F]* [RT])").map(str.encode),
    st.sampled_from([b"", b"#", b"#: a = 1", b"(1.0) a > 00", b"(1.0) a < 0", b"(1.0) a 605#0 R", b"(1.0) a ! open"]),
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("wires")


def written(file: Path, calls: list[tuple[object, ...]], config: str) -> list[WireEvent]:
    """Make a recording of these calls of a tap; what must be read from it, without times."""
    with WireLogWriter(file, config, BEGAN, most_bytes=10**6) as writer:
        tap = writer.tap("bus1")
        for name, *arguments in calls:
            getattr(tap, str(name))(*arguments)
    expected = []
    for call in calls:
        match call:
            case ("data", bool(sent), bytes(data)):
                expected.append(WireEvent(0.0, "bus1", "sent" if sent else "received", data))
            case ("frame", bool(sent), int(identifier), bool(extended), bytes(data)):
                expected.append(WireEvent(0.0, "bus1", "sent" if sent else "received", data, identifier, extended))
            case ("note", str(text)):
                note = "".join(c if c.isprintable() else " " for c in text)
                expected.append(WireEvent(0.0, "bus1", "note", note=note))
    return expected


def without_times(events: tuple[WireEvent, ...]) -> list[WireEvent]:
    return [WireEvent(0.0, e.bus, e.passed, e.data, e.identifier, e.extended, e.note) for e in events]


@pytest.mark.slow
@given(calls=st.lists(CALL, max_size=8), config=CONFIG)
def test_what_was_written_is_read(folder: Path, calls: list[tuple[object, ...]], config: list[str]) -> None:
    file = folder / "whole.wire"
    expected = written(file, calls, "\n".join(config))
    log = read_wire_log(file)
    assert without_times(log.events) == expected
    assert log.config == "\n".join(config).removesuffix("\n")
    assert [event.at_s for event in log.events] == sorted(event.at_s for event in log.events)


@pytest.mark.slow
@given(calls=st.lists(CALL, min_size=1, max_size=4), config=CONFIG, data=st.data())
def test_cut_anywhere_it_holds_the_lines_that_are_whole(
    folder: Path, calls: list[tuple[object, ...]], config: list[str], data: st.DataObject
) -> None:
    file = folder / "cut.wire"
    expected = written(file, calls, "\n".join(config))
    whole = file.read_bytes()
    cut = data.draw(st.integers(len(FIRST), len(whole)))
    file.write_bytes(whole[:cut])
    log = read_wire_log(file)
    lines = whole[:cut].count(b"\n") - (whole.count(b"\n") - len(calls))
    assert without_times(log.events) == expected[: max(0, lines)]
    assert "\n".join(config).startswith(log.config)


@pytest.mark.slow
@given(lines=st.lists(LINE, max_size=6), ended=st.booleans())
def test_any_bytes_are_read_or_refused_with_the_line(folder: Path, lines: list[bytes], ended: bool) -> None:
    file = folder / "any.wire"
    file.write_bytes(FIRST + b"\n".join(lines) + b"\n" * ended)
    texts = file.read_bytes().decode(errors="replace").split("\n")[1:-1]  # a carriage return ends no line
    try:
        log = read_wire_log(file)
    except WireLogError as error:
        found = re.search(r"any\.wire, line (\d+): cannot be read: ", str(error))
        assert found is not None
        assert texts[int(found[1]) - 2][:1] not in ("", "#")
        return
    assert len(log.events) == sum(1 for text in texts if text and not text.startswith("#"))
    for event in log.events:
        digits = event.data.hex()
        assert any(event.bus in text and (digits in text.lower() and event.note in text) for text in texts)
