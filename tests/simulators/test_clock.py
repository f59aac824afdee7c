"""The bench's clock: scaled, stopped while held, the same for a second process's view of it.

Here it scales simulated time: a sleep lasts exactly as long as stated.
"""

import asyncio
import time
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from simulators.clock import SharedClock

pytestmark = pytest.mark.simulated_time

EPOCH = datetime(2026, 1, 5, 6, tzinfo=UTC)
READ_S = 0.01
"""Each look at the computer's clock takes a little simulated time, here a thousandfold."""


@pytest.fixture
def clock(tmp_path: Path) -> Iterator[SharedClock]:
    clock = SharedClock(tmp_path / "clock", epoch=EPOCH, speed=1000.0, owner=True)
    yield clock
    clock.close()


def test_runs_at_its_speed_only_between_start_and_stop(clock: SharedClock) -> None:
    assert clock.monotonic() == 0.0
    time.sleep(0.02)
    assert clock.monotonic() == 0.0
    clock.start()
    time.sleep(0.02)
    assert clock.monotonic() == pytest.approx(20.0, abs=READ_S)
    clock.stop()
    time.sleep(0.02)
    stopped = clock.monotonic()
    assert stopped == pytest.approx(20.0, abs=READ_S)
    assert clock.utc() == EPOCH + timedelta(seconds=stopped)


def test_clock_stands_still_while_anybody_holds_it(clock: SharedClock) -> None:
    clock.start()
    with clock.hold():
        with clock.hold():
            pass
        before = clock.monotonic()
        time.sleep(0.01)
        assert clock.monotonic() == before
    time.sleep(0.01)
    assert clock.monotonic() == pytest.approx(before + 10.0, abs=READ_S)


def test_a_reader_sees_the_owners_time_and_may_not_change_it(clock: SharedClock, tmp_path: Path) -> None:
    reader = SharedClock(tmp_path / "clock", epoch=EPOCH, speed=1000.0)
    with clock.hold():
        assert reader.monotonic() == clock.monotonic()
    with pytest.raises(PermissionError):
        reader.start()
    reader.close()


async def test_sleepers_wake_at_the_simulated_time(clock: SharedClock) -> None:
    clock.start()
    sleeper = asyncio.create_task(clock.sleep_until(100.0))
    await asyncio.sleep(0)
    with clock.hold():
        await asyncio.sleep(0.15)
        assert not sleeper.done()
    await sleeper
    assert clock.monotonic() == pytest.approx(100.0, abs=READ_S)


async def test_time_waits_for_an_owner_that_is_kept_from_running(clock: SharedClock, tmp_path: Path) -> None:
    reader = SharedClock(tmp_path / "clock", epoch=EPOCH, speed=1000.0)
    clock.start()
    woke: list[float] = []

    async def sleep(until_s: float) -> None:
        await clock.sleep_until(until_s)
        woke.append(clock.monotonic())

    sleepers = [asyncio.create_task(sleep(due)) for due in (20.0, 5.0)]
    await asyncio.sleep(0)
    time.sleep(0.1)  # noqa: ASYNC251 - a busy computer: 100 simulated seconds without a turn for the owner
    assert reader.monotonic() == clock.monotonic() == 5.0
    await asyncio.gather(*sleepers)
    assert woke[0] <= 20.0 <= woke[1]
    reader.close()
