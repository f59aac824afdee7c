"""Waits for what a store does in its own time, on the computer's clock."""

import time
from collections.abc import Callable

from gateway.storage import Store

_LIMIT_S = 60.0


def until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + _LIMIT_S
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def until_failing(store: Store) -> None:
    until(lambda: bool(store.health.problem))


def until_all_written(store: Store) -> None:
    """Wait until nothing is left to write and the store reports no problem."""
    until(lambda: not store.health.problem and not store.health.waiting)
