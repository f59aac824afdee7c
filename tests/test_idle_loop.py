"""The loop of the tests knows when it has nothing to do, and so does the time of clocks that wait for that."""

import asyncio
import socket
import threading

import pytest

from tests.benches.idle_loop import idle
from tests.benches.stepped_clock import SteppedClock
from tests.benches.wire_clock import WireClock

LATER_S = 0.05


async def test_it_is_idle_only_after_the_last_of_tasks_that_wake_each_other() -> None:
    woken = [asyncio.Event() for _ in range(1000)]

    async def wake(k: int) -> None:
        await woken[k].wait()
        woken[k + 1].set()

    tasks = [asyncio.create_task(wake(k)) for k in range(len(woken) - 1)]
    woken[0].set()
    await idle()
    assert all(task.done() for task in tasks)


async def test_what_has_arrived_is_read_first() -> None:
    loop, read = asyncio.get_running_loop(), list[bytes]()
    ours, theirs = socket.socketpair()
    with ours, theirs:
        ours.setblocking(False)
        loop.add_reader(ours, lambda: read.append(ours.recv(1)))
        theirs.send(b"thr")
        await idle()
        loop.remove_reader(ours)
    assert read == [b"t", b"h", b"r"]


@pytest.mark.parametrize(("clock", "waits"), [(SteppedClock(), False), (WireClock(), True)])
async def test_only_the_clock_for_wires_waits_for_who_holds_it(clock: SteppedClock, waits: bool) -> None:
    go = threading.Event()

    async def work() -> None:
        with clock.hold():
            asyncio.get_running_loop().call_later(LATER_S, go.set)
            await asyncio.to_thread(go.wait)

    working = asyncio.create_task(work())
    await clock.rest()
    assert go.is_set() is waits
    assert (clock.holds == 0) is waits
    await working


async def test_a_second_wait_is_refused_until_the_first_has_ended() -> None:
    first = asyncio.create_task(idle(lambda: False))
    await asyncio.sleep(0)
    with pytest.raises(AssertionError, match="one wait at a time"):
        await idle()
    first.cancel()
    await asyncio.gather(first, return_exceptions=True)
    await idle()
