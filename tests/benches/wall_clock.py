"""A computer whose wall clock jumps: tests run in a process whose C library tells another time."""

import ctypes
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
HOUR_S = 3600


def jump(seconds: int) -> None:
    """Set the wall clock of this process, for every module and library in it; it was started by `run_tests`."""
    ctypes.CDLL(None).jump_wall_clock(ctypes.c_long(seconds))


def run_tests(file: Path, folder: Path) -> None:
    """Run the tests of this file, which may `jump`. Fails when one of them does."""
    library = folder / "wall_clock.so"
    source = Path(__file__).with_suffix(".cc")
    subprocess.run(["g++", "-std=c++17", "-O1", "-shared", "-fPIC", "-o", library, source, "-ldl"], check=True)
    run = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", f"--basetemp={folder / 'run'}", str(file)]
    done = subprocess.run(
        run,
        cwd=ROOT,
        env=os.environ | {"LD_PRELOAD": str(library)},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-6000:] + done.stderr[-2000:]
    assert "passed" in done.stdout
