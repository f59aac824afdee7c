"""Files that somebody hands to a command: a pipe is refused at once, and no small file takes all memory."""

import os
import resource
import subprocess
import sys
import threading
from pathlib import Path

import click
import numpy as np
import pyarrow as pa
import pytest
from click.testing import CliRunner
from pyarrow import parquet

from gateway.acquisition.wire_log import WireLogError, read_wire_log
from gateway.cli.exits import Commands
from gateway.cli.main import main
from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.reporting.recordings.columns import Columns
from gateway.reporting.recordings.grid import read_recording
from gateway.runtime.bounded_memory import MemoryBoundError, memory_for

BEGIN = "# talc wire log 1\n"


@pytest.mark.parametrize(
    "command",
    [
        ("replay", "PIPE"),
        ("play", "PIPE"),
        ("report", "PIPE"),
        ("db", "check", "PIPE"),
        ("prior", "make", "PIPE", "-o", "made.json"),
        ("check", "PIPE"),
        ("init", "gateway.toml", "--answers", "PIPE"),
        ("watch", "--authority", "PIPE"),
        ("watch", "--user", "me", "--password-file", "PIPE"),
    ],
    ids=" ".join,
)
def test_a_pipe_is_refused_at_once(command: tuple[str, ...], tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    done = CliRunner().invoke(main, [str(pipe) if word == "PIPE" else word for word in command], env={"LANG": "de_DE"})
    assert done.exit_code == 2
    assert "eine Pipe oder ein Gerät, keine Datei" in done.output


@pytest.mark.parametrize(
    ("wanted", "left_later"), [("import numpy", "2**22"), ("threading.Thread(target=print).start()", "2**28")]
)
def test_a_process_that_may_take_too_little_memory_says_so(wanted: str, left_later: str) -> None:
    program = f"""
import click, resource, threading
from gateway.cli.exits import Commands
from gateway.runtime.bounded_memory import address_space_left

@click.group(cls=Commands)
def group(): pass

def leave(size):
    resource.setrlimit(resource.RLIMIT_AS, (2**32, 2**32))
    resource.setrlimit(resource.RLIMIT_AS, (int(2**32 - address_space_left() + size), 2**32))

@group.command()
def one():
    leave(2**22)
    try:
        {wanted}
    finally:
        leave({left_later})

group(["one"])
"""
    done = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "LANG": "de_DE"},
        capture_output=True,
        text=True,
        timeout=60.0,
    )
    said = Text(NoticeCode.TOO_LITTLE_MEMORY, why="").in_language("de")
    assert (done.returncode, said in done.stderr, "Traceback" in done.stderr) == (3, True, False), done.stderr


def test_a_thread_that_cannot_start_is_told_whatever_the_limit_is() -> None:
    @click.command()
    def one() -> None:
        threading.stack_size(2**47)
        try:
            threading.Thread(target=print).start()
        finally:
            threading.stack_size(0)

    done = CliRunner().invoke(Commands(commands={"one": one}), ["one"], env={"LANG": "de_DE"})
    assert done.exit_code == 3
    assert Text(NoticeCode.TOO_LITTLE_MEMORY, why="").in_language("de") in done.output


def test_a_few_bytes_of_parquet_that_stand_for_gigabytes_are_refused(tmp_path: Path) -> None:
    file, many = tmp_path / "machine.parquet", 7_000_000
    column = pa.array(np.zeros(many))
    parquet.write_table(pa.table({"time": column, "bed": column, "EX0C": column}), file, compression="zstd")
    del column
    before = resource.getrlimit(resource.RLIMIT_DATA)
    with pytest.raises(MemoryBoundError), memory_for(file):
        read_recording(file, Columns(), 300.0)
    assert resource.getrlimit(resource.RLIMIT_DATA) == before


def test_a_wire_log_of_one_endless_line_or_too_many_messages_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gateway.acquisition.wire_log.MOST_EVENTS", 10)
    file = tmp_path / "wires.log"
    for text, code in (("(1.0) a > " + "0" * 2**24, "wire_log_line"), ("(1.0) a > 00\n" * 11, "wire_log_long")):
        file.write_text(BEGIN + text, encoding="utf-8")
        with pytest.raises(WireLogError) as refused:
            read_wire_log(file)
        assert refused.value.args[0].code == code
    file.write_text(BEGIN + "(1.0) a > 00\n" * 10 + "(1.0) a >", encoding="utf-8")
    assert len(read_wire_log(file).events) == 10, "a line that a power cut ended is left out"
