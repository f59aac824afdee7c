"""Every test must leave the process as it found it: no task, thread, socket or terminal may stay behind."""

import asyncio
import gc
import inspect
import os
import threading
import time
from collections.abc import AsyncIterator, Generator, Iterator
from itertools import chain, groupby, islice

import pytest
from hypothesis import HealthCheck, settings

from tests.benches.idle_loop import IdleLoop
from tests.benches.processes import open_links
from tests.benches.simulated_time import real_monotonic_s, simulated_time

# Before NumPy is imported: tests run side by side, and BLAS threads that wait for a core cost a hundredfold.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Imports and the collection of tests make nearly a million objects, which stay to the end: the garbage collector is off
# meanwhile and ignores them afterwards, or it would look through them again and again.
gc.disable()

# How long an example takes depends on this computer, not on the code.
settings.register_profile("any computer", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any computer")

_GRACE_S = 30.0
"""Threads of C libraries end a moment after their object is closed, on a busy computer some seconds."""


def pytest_asyncio_loop_factories() -> dict[str, type[IdleLoop]]:
    return {"idle": IdleLoop}


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the tests that wait for minutes on half of the workers, with the files of slow ones on the others.

    pytest-xdist gives each worker the next part of the list, and moves tests at the end of a part to workers that have
    none left: there are only short ones at the end, so that no worker ends with a long one while the others are idle.
    Last of all hooks: what `-m` leaves out would move the borders between the parts.
    """
    workers, left = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1")), len(items)
    first: list[list[pytest.Item]] = [[] for _ in range(workers)]
    lasting = [0.0] * max(1, workers // 2)
    for item in sorted(items, key=_waits_s, reverse=True):
        if (waits_s := _waits_s(item)) > 0:
            least = lasting.index(min(lasting))
            lasting[least] += waits_s
            first[least].append(item)
    working = first[len(lasting) :] or first
    others = {path: list(file) for path, file in groupby((i for i in items if not _waits_s(i)), lambda i: i.path)}
    for marker in ("slow", "peer"):
        long = [path for path, file in others.items() if any(item.get_closest_marker(marker) for item in file)]
        for turn, path in enumerate(reversed(long)):  # the longest are the system's, which come last in the list
            working[turn % len(working)] += others.pop(path)
    short = chain.from_iterable(others.values())
    ordered: list[pytest.Item] = []
    for worker, begins in enumerate(first):
        part = left // (workers - worker)
        ordered += [*begins, *islice(short, max(0, part - len(begins)))]
        left -= part
    items[:] = [*ordered, *short]


def _waits_s(item: pytest.Item) -> float:
    """How long a test waits, by its marker."""
    marker = item.get_closest_marker("waits")
    return 0.0 if marker is None else float(marker.args[0])


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.set_threshold(10_000)  # `no_leaks` collects whenever something is left open; it does not wait for this
    gc.enable()


_phase_began_s = pytest.StashKey[float]()
"""When setup, call or teardown of a test on simulated time began, by the computer's clock."""


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Run the whole of a test marked `simulated_time` on simulated time."""
    if item.get_closest_marker("simulated_time") is None:
        return (yield)
    item.stash[_phase_began_s] = real_monotonic_s()
    with simulated_time():
        return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Report how long it took, not how much time was simulated."""
    report = yield
    if (began_s := item.stash.get(_phase_began_s, None)) is not None:
        item.stash[_phase_began_s] = real_monotonic_s()
        report.duration = item.stash[_phase_began_s] - began_s
    return report


@pytest.fixture
async def no_leaked_tasks() -> AsyncIterator[None]:
    yield
    left = [t for t in asyncio.all_tasks() if t is not asyncio.current_task() and not t.done()]
    assert not left, f"tasks left behind: {left}"


def _open_channels() -> set[str]:
    """Sockets and terminals that this process has open."""
    return {link for link in open_links() if link.startswith(("socket:", "/dev/pts/", "/dev/ptmx"))}


@pytest.fixture(autouse=True)
def no_leaks(request: pytest.FixtureRequest) -> Iterator[None]:
    """Fail the test that leaves threads, asyncio tasks, sockets or terminals behind."""
    if inspect.iscoroutinefunction(getattr(request.node, "obj", None)):
        request.getfixturevalue("no_leaked_tasks")
    threads, channels = set(threading.enumerate()), _open_channels()
    yield
    deadline, pause_s = time.monotonic() + _GRACE_S, 0.001
    while True:
        # The loop's default executor ends with the loop, which is after this fixture.
        now = [t for t in threading.enumerate() if not t.name.startswith("asyncio_")]
        new_threads = [t for t in now if t not in threads and t.is_alive()]
        new_channels = _open_channels() - channels
        if not (new_threads or new_channels) or time.monotonic() > deadline:
            break
        time.sleep(pause_s)
        pause_s = min(2.0 * pause_s, 0.1)
        if pause_s == 0.1:  # it takes 0.2 s once the large libraries are imported, and most objects only need a moment
            gc.collect()
    assert not new_threads, f"threads left behind: {new_threads}"
    assert not new_channels, f"sockets or terminals left open: {new_channels}"
