"""The backlog for a slow network is bounded, and so is the memory that a foreign query can occupy."""

import subprocess
import sys
import threading
from pathlib import Path

import pytest

from gateway.telemetry.backlog import Backlog
from tests.benches.free_port import free_port
from tests.benches.zenoh_sessions import client

PUBLISHING = """
import asyncio, sys
from tests.benches.telemetry_peer import problem, telemetry

async def main(port):
    async with telemetry(port) as publisher:
        publisher.publish(problem("the only one"))
        print("published", flush=True)
        await asyncio.to_thread(sys.stdin.readline)

asyncio.run(main(int(sys.argv[1])))
"""


def drained(backlog: Backlog) -> list[str]:
    backlog.close()
    found = []
    while messages := backlog.take():
        found += [suffix for suffix, _ in messages]
    return found


def test_messages_leave_in_the_order_in_which_they_came() -> None:
    backlog = Backlog(10, 10, 1000, 0.0)
    for number in range(8):
        backlog.put([(f"m{number}", b"x")], firm=number % 3 == 0)
    assert drained(backlog) == [f"m{number}" for number in range(8)]
    assert (backlog.dropped_loose, backlog.dropped_firm) == (0, 0)


def test_of_too_many_messages_the_oldest_that_may_be_lost_are_dropped_and_no_others() -> None:
    backlog = Backlog(3, 10, 1000, 0.0)
    for number in range(10):
        backlog.put([(f"loose{number}", b"x" * 200)], firm=False)
        if number % 2 == 0:
            backlog.put([(f"firm{number}", b"x")], firm=True)
    assert drained(backlog) == ["firm0", "firm2", "firm4", "firm6", "loose7", "loose8", "firm8", "loose9"]
    assert (backlog.dropped_loose, backlog.dropped_firm) == (7, 0)


@pytest.mark.parametrize(("most", "most_bytes"), [(4, 1000), (100, 40)])
def test_what_must_arrive_is_bounded_in_number_and_size_and_the_newest_stay(most: int, most_bytes: int) -> None:
    backlog = Backlog(3, most, most_bytes, 0.0)
    for number in range(1000):
        backlog.put([(f"firm{number}", b"x" * 10)], firm=True)
    assert backlog.dropped_firm == 996
    assert drained(backlog) == [f"firm{number}" for number in range(996, 1000)]


def test_a_taker_waits_for_the_next_message_and_ends_with_the_last() -> None:
    backlog, found = Backlog(3, 3, 100, 0.0), list[str]()

    def take() -> None:
        while messages := backlog.take():
            found.extend(suffix for suffix, _ in messages)

    thread = threading.Thread(target=take)
    thread.start()
    for name in ("a", "b"):
        backlog.put([(name, b"x")], firm=True)
    backlog.close()
    thread.join(60.0)
    assert not thread.is_alive()
    assert found == ["a", "b"]


def test_what_may_be_lost_leaves_together_and_at_once_when_something_must_arrive() -> None:
    backlog, found, took = Backlog(300, 3, 100, 3600.0), list[list[str]](), threading.Semaphore(0)

    def take() -> None:
        while messages := backlog.take():
            found.append([suffix for suffix, _ in messages])
            took.release()

    thread = threading.Thread(target=take)
    thread.start()
    for name in ("a", "b", "c"):
        backlog.put([(name, b"x")], firm=False)
    backlog.put([("must", b"x")], firm=True)
    assert took.acquire(timeout=60.0)
    many = [f"n{number}" for number in range(200)]
    for name in many:
        backlog.put([(name, b"x")], firm=False)
    assert took.acquire(timeout=60.0)
    backlog.put([("last", b"x")], firm=False)
    backlog.close()
    thread.join(60.0)
    assert not thread.is_alive()
    assert found == [["a", "b", "c", "must"], many, ["last"]]


def largest_mb(process: int) -> float:
    """Largest resident size so far."""
    status = Path(f"/proc/{process}/status").read_text(encoding="ascii")
    return next(int(line.split()[1]) / 1e3 for line in status.splitlines() if line.startswith("VmHWM"))


@pytest.mark.slow
def test_a_large_query_is_refused_before_it_is_in_memory_and_small_ones_are_answered() -> None:
    port = free_port()
    command = [sys.executable, "-c", PUBLISHING, str(port)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "published\n"
        try:
            with client(port) as session:
                assert [r.ok is not None for r in session.get("talc/mill/**", timeout=60.0)] == [True]
                before_mb = largest_mb(process.pid)
                large = session.get("talc/mill/**", payload=bytes(100_000_000), timeout=600.0)
                small = session.get("talc/mill/**", payload=bytes(100_000), timeout=60.0)
                assert [r.ok is not None for r in small] == [True], "by the same link, so after the large one"
                assert large.try_recv() is None
                assert largest_mb(process.pid) - before_mb < 20.0
        finally:
            process.kill()
