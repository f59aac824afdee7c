"""Commands open a database on a disk that hangs: they say so and end, and a stop does not wait for the disk."""

import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest

from gateway.config.file import load
from gateway.storage.store import Store
from tests.benches.failing_disk import on_failing_disk
from tests.benches.manual_clock import ManualClock
from tests.benches.service_file import UNPUBLISHED, m7015, rtu_bus

pytestmark = [pytest.mark.slow, pytest.mark.waits(25)]

LIMIT_S = 300.0
"""Real seconds; the commands themselves wait 20 s for the disk."""
COMMANDS = (
    ("run", "gateway.toml"),
    ("status", "gateway.toml"),
    ("doctor", "gateway.toml"),
    ("db", "check", "disk/gateway.sqlite"),
    ("db", "backup", "disk/gateway.sqlite", "-o", "copy.sqlite"),
)


@contextmanager
def hanging_in(folder: Path) -> Iterator[Path]:
    """A configuration beside a database on a disk that hangs while the file is there."""
    (folder / "disk").mkdir(parents=True)
    (folder / "gateway.toml").write_text(
        f'{UNPUBLISHED}\n[storage]\npath = "disk/gateway.sqlite"\n' + rtu_bus() + m7015(), encoding="utf-8"
    )
    with Store(load(folder / "gateway.toml").storage.path, "boot", ManualClock()):
        pass
    (folder / "hanging").touch()
    yield folder / "hanging"
    (folder / "hanging").unlink(missing_ok=True)


def said_by(hanging: Path, command: tuple[str, ...], code: int, *, stopped: bool = False) -> str:
    """What a command writes to standard error until it ends with this code, while the disk hangs."""
    folder = hanging.parent
    done = subprocess.run(
        [sys.executable, "-m", "gateway", *command],
        cwd=folder,
        env=on_failing_disk(folder / "disk", hanging, reads=True, stopped=stopped),
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    assert hanging.exists()
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr
    return done.stderr


def test_a_command_says_what_does_not_answer_and_ends(tmp_path: Path) -> None:
    """Beside each other, as each waits for most of its time."""

    def said(number: int) -> str:
        with hanging_in(tmp_path / str(number)) as hanging:
            return said_by(hanging, COMMANDS[number], 3)

    with ThreadPoolExecutor() as beside:
        for text in beside.map(said, range(len(COMMANDS))):
            assert "disk/gateway.sqlite: the disk does not answer (waited 20 s)" in text
            assert "dmesg" in text


def test_a_gateway_that_waits_for_its_database_is_stopped_without_it(tmp_path: Path) -> None:
    with hanging_in(tmp_path / "gateway") as hanging:
        said = said_by(hanging, ("run", "gateway.toml"), 0, stopped=True)
    assert "gateway.sqlite: stopped before it was open" in said
