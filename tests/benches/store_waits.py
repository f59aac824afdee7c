"""Waits for what a store does in its own time, on the computer's clock."""

from gateway.storage.store import Store
from tests.benches.waits import wait_until


def until_failing(store: Store) -> None:
    wait_until(lambda: store.health.problem)


def until_all_written(store: Store) -> None:
    """Wait until nothing is left to write and the store reports no problem."""
    wait_until(lambda: not store.health.problem and not store.health.waiting)
