"""Waits for a condition that end: where the condition never comes true, the test fails and does not hang.

The limit is the computer's time, also where the loop's clock is a test's own. What is no condition has limits of its
own: `asyncio.timeout` for an event or a task, a timeout for what a thread waits for.
"""

import asyncio
import time
from collections.abc import Callable, Iterator

LIMIT_S = 60.0
"""Many times what any of these waits takes on a slow computer."""


async def until(condition: Callable[[], object], limit_s: float = LIMIT_S, pause_s: float = 0.01) -> None:
    """Look until the condition is true; the loop's other tasks run in between."""
    end_s = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end_s, f"not within {limit_s:g} s"
        await asyncio.sleep(pause_s)


def wait_until(condition: Callable[[], object], limit_s: float = LIMIT_S, pause_s: float = 0.01) -> None:
    """The same without a loop."""
    end_s = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end_s, f"not within {limit_s:g} s"
        time.sleep(pause_s)


def turns(most: int = 10_000) -> Iterator[int]:
    """Number the turns of a loop from 1 on, which leaves it in time: after so many the test fails."""
    yield from range(1, most + 1)
    raise AssertionError(f"not within {most} turns")
