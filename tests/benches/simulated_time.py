"""Simulated time for a whole process: clocks that advance only when every thread sleeps and every wire is quiet.

A test marked `simulated_time` runs on it, fixtures included, with the real event loop, threads, sockets and
pseudo-terminals. Work takes no simulated time, however slow or busy the computer is, and waiting takes no real time. It
is for work within this process: another process would not wait for it, unless time is held while that process works.
"""

import ctypes
import hashlib
import os
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

_FOLDER = Path(__file__).with_name("time_library")


@cache
def _library() -> ctypes.CDLL:
    """The library, compiled once for each user and version of the source. Raises subprocess.CalledProcessError."""
    mark = hashlib.sha256(b"\n".join(file.read_bytes() for file in sorted(_FOLDER.iterdir()))).hexdigest()[:16]
    name = f"talc-gateway-simulated-time-{os.getuid()}-{mark}.so"
    path = Path(tempfile.gettempdir()) / name
    if not path.exists():
        with tempfile.TemporaryDirectory() as folder:
            made = Path(folder) / name
            compiler = ["g++", "-std=c++17", "-O2", "-shared", "-fPIC", "-Wall", "-Wextra", "-Werror"]
            subprocess.run([*compiler, "-o", made, *_FOLDER.glob("*.cc"), "-lpthread", "-lutil"], check=True)
            made.replace(path)  # in one step, because other workers may look
    library = ctypes.CDLL(str(path))
    library.real_monotonic_s.restype = ctypes.c_double
    library.steps_of_simulated_time.restype = ctypes.c_uint64
    return library


def real_monotonic_s() -> float:
    """The computer's own clock, also within simulated time."""
    return float(_library().real_monotonic_s())


def steps_of_time() -> int:
    """How often simulated time has advanced so far: each step ends the waits with the earliest deadline."""
    return int(_library().steps_of_simulated_time())


def jump_wall_clock(seconds: int) -> None:
    """Set the wall clock of this process, s ahead; the monotonic clock stays. Within simulated time."""
    _library().jump_simulated_wall_clock(ctypes.c_long(seconds))


@contextmanager
def held_time() -> Iterator[None]:
    """Inside, simulated time stands still even if every thread sleeps, such as while another process works."""
    hold = _library().hold_simulated_time
    hold(1)
    try:
        yield
    finally:
        hold(-1)


@contextmanager
def simulated_time() -> Iterator[None]:
    """Inside, the clocks of this process are simulated; they begin with the real time, and end with it."""
    library = _library()
    library.begin_simulated_time()
    try:
        yield
    finally:
        library.end_simulated_time()
