"""A disk that does not answer is reported after its time, and nobody waits longer for it."""

import asyncio
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from gateway.storage.answers import DiskWork, answered, long_work
from gateway.storage.faults import StoreError

PATH = Path("/disk/gateway.sqlite")
pytestmark = pytest.mark.simulated_time


class HangingDisk:
    """Work that ends when the disk answers."""

    def __init__(self) -> None:
        self.answers, self.begun, self.left = threading.Event(), threading.Event(), threading.Event()

    def read(self) -> str:
        self.begun.set()
        self.answers.wait()
        return "rows"

    def leave(self, found: str) -> None:
        assert found == "rows"
        self.left.set()


@pytest.fixture
def disk() -> Iterator[HangingDisk]:
    hanging = HangingDisk()
    yield hanging
    hanging.answers.set()


def test_what_is_found_or_raised_is_passed_on() -> None:
    def damaged() -> str:
        raise StoreError("damaged")

    assert answered(PATH, lambda: "rows") == "rows"
    with pytest.raises(StoreError, match=r"^damaged$"):
        answered(PATH, damaged)


def test_a_disk_that_answers_in_time_is_no_fault() -> None:
    def slow() -> str:
        time.sleep(19.0)
        return "rows"

    assert answered(PATH, slow) == "rows"


def test_a_disk_that_does_not_answer_is_reported_after_its_time(disk: HangingDisk) -> None:
    began_s = time.monotonic()
    with pytest.raises(StoreError, match=r"^/disk/gateway.sqlite: the disk does not answer \(waited 20 s\): .*dmesg"):
        answered(PATH, disk.read)
    assert time.monotonic() - began_s == pytest.approx(20.0, abs=0.1)


def test_a_migration_or_repair_takes_as_long_as_it_takes_and_the_time_counts_again_after_it(disk: HangingDisk) -> None:
    def migrate() -> str:
        with long_work():
            time.sleep(3600.0)
        return disk.read()

    began_s = time.monotonic()
    with pytest.raises(StoreError, match="does not answer"):
        answered(PATH, migrate)
    assert time.monotonic() - began_s == pytest.approx(3620.0, abs=0.1)


async def test_waiting_for_it_the_event_loop_runs_and_the_fault_is_the_same(disk: HangingDisk) -> None:
    began_s = time.monotonic()
    waiting = asyncio.create_task(DiskWork(PATH, disk.read).until(asyncio.Event()))
    await asyncio.sleep(19.9)
    assert not waiting.done()
    with pytest.raises(StoreError, match="does not answer"):
        await waiting
    assert time.monotonic() - began_s == pytest.approx(20.0, abs=0.1)


async def test_a_stop_waits_a_second_and_what_comes_later_is_left(disk: HangingDisk) -> None:
    stop, began_s = asyncio.Event(), time.monotonic()
    asyncio.get_running_loop().call_later(5.0, stop.set)
    assert await DiskWork(PATH, disk.read, unwanted=disk.leave).until(stop) is None
    assert time.monotonic() - began_s == pytest.approx(6.0, abs=0.1)
    disk.answers.set()
    assert await asyncio.to_thread(disk.left.wait, 60.0)


async def test_what_comes_within_that_second_still_counts(disk: HangingDisk) -> None:
    stop, loop = asyncio.Event(), asyncio.get_running_loop()
    loop.call_later(5.0, stop.set)
    loop.call_later(5.5, disk.answers.set)
    assert await DiskWork(PATH, disk.read, unwanted=disk.leave).until(stop) == "rows"
    assert not disk.left.is_set()


@pytest.mark.parametrize("answers_s", [0.5, 60.0])
async def test_cancelled_it_leaves_what_comes(answers_s: float, disk: HangingDisk) -> None:
    waiting = asyncio.create_task(DiskWork(PATH, disk.read, unwanted=disk.leave).until(asyncio.Event()))
    await asyncio.to_thread(disk.begun.wait)
    waiting.cancel()
    asyncio.get_running_loop().call_later(answers_s, disk.answers.set)
    with pytest.raises(asyncio.CancelledError):
        await waiting
    assert await asyncio.to_thread(disk.left.wait, 600.0)
