"""Makes once what takes long and several workers of a test run need: the first worker makes it, the others wait for
it."""

import os
import shutil
from collections.abc import Callable
from fcntl import LOCK_EX, flock
from pathlib import Path

import pytest


def run_folder(folders: pytest.TempPathFactory) -> Path:
    """A folder that all workers of this run have, and no other run."""
    own = folders.getbasetemp()
    return own.parent if "PYTEST_XDIST_WORKER" in os.environ else own


def made_once(folder: Path, make: Callable[[Path], object]) -> Path:
    """The folder, which `make` has filled under another name; if it failed, the next worker that asks tries again."""
    begun = folder.with_name(f"{folder.name}-begun")
    with folder.with_name(f"{folder.name}-lock").open("w") as lock:
        flock(lock, LOCK_EX)
        if not folder.exists():
            shutil.rmtree(begun, ignore_errors=True)
            begun.mkdir()
            make(begun)
            begun.rename(folder)
    return folder
