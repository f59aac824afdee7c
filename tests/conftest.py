"""Every test must leave the process as it found it: no task, thread, socket or terminal may stay behind."""

import asyncio
import gc
import inspect
import os
import threading
import time
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import pytest

# Before NumPy is imported: tests run side by side, and BLAS threads that wait for a core cost a hundredfold.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

_GRACE_S = 2.0
"""Threads of C libraries end a moment after their object is closed."""


@pytest.fixture
async def _no_leaked_tasks() -> AsyncIterator[None]:
    yield
    left = [t for t in asyncio.all_tasks() if t is not asyncio.current_task() and not t.done()]
    assert not left, f"tasks left behind: {left}"


def _open_channels() -> set[str]:
    """Sockets and terminals this process holds."""
    found = set()
    for link in Path("/proc/self/fd").iterdir():
        try:
            target = str(link.readlink())
        except FileNotFoundError:
            continue
        if target.startswith(("socket:", "/dev/pts/", "/dev/ptmx")):
            found.add(target)
    return found


@pytest.fixture(autouse=True)
def no_leaks(request: pytest.FixtureRequest) -> Iterator[None]:
    """Fail the test that leaves threads, asyncio tasks, sockets or terminals behind."""
    if inspect.iscoroutinefunction(getattr(request.node, "obj", None)):
        request.getfixturevalue("_no_leaked_tasks")
    threads, channels = set(threading.enumerate()), _open_channels()
    yield
    deadline = time.monotonic() + _GRACE_S
    while True:
        # The loop's default executor ends with the loop, which is after this fixture.
        now = [t for t in threading.enumerate() if not t.name.startswith("asyncio_")]
        new_threads = [t for t in now if t not in threads and t.is_alive()]
        new_channels = _open_channels() - channels
        if not (new_threads or new_channels) or time.monotonic() > deadline:
            break
        gc.collect()
        time.sleep(0.01)
    assert not new_threads, f"threads left behind: {new_threads}"
    assert not new_channels, f"sockets or terminals left open: {new_channels}"
