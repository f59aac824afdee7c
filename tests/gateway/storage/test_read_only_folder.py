"""A database in a folder that cannot be written is not another program's file, and is not reported as one."""

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from gateway.storage.store import Store
from tests.benches.stepped_clock import SteppedClock

NOBODY = 65534
PROGRAM = """
import sys
from pathlib import Path
from gateway.storage.history import History; from gateway.storage.faults import StoreError
import os
if os.geteuid() == 0:
    os.setgid({nobody}), os.setuid({nobody})
try:
    History(Path(sys.argv[1]))
except StoreError as error:
    print(error)
"""


@pytest.fixture
def folder() -> Iterator[Path]:
    """A folder that everybody may read, which pytest's folders are not."""
    with tempfile.TemporaryDirectory() as name:
        path = Path(name)
        yield path
        with suppress(FileNotFoundError):
            path.chmod(0o755)


@pytest.mark.slow
def test_the_folder_is_named_and_not_the_file_blamed(folder: Path) -> None:
    database = folder / "gateway.sqlite"
    with Store(database, "boot-1", SteppedClock()) as store:
        store.begin("{}", "mark", "{}")
    folder.chmod(0o555)
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM.format(nobody=NOBODY), str(database)],
        capture_output=True, text=True, check=True, env={**os.environ, "PYTHONPATH": str(Path.cwd())},
    )  # fmt: skip
    assert f"{database}: cannot be opened: the folder {folder} cannot be written" in done.stdout
    assert "not a database" not in done.stdout
