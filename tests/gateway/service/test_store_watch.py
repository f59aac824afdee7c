"""Reports about the store: failures and a disk that fills up, each beginning and each end once."""

from pathlib import Path

from gateway.config.sections import Storage
from gateway.model.events import GatewayEvent, StorageChanged, StoreHealth
from gateway.model.notice import Notice
from gateway.model.text import plain
from gateway.service.store_watch import StoreWatch
from tests.benches.stepped_clock import SteppedClock
from tests.benches.tasks import running

FULL = "database or disk is full"


class WatchedStore:
    """A watch on a store whose health the test sets."""

    def __init__(self) -> None:
        self.clock = SteppedClock()
        self.health = StoreHealth(free_mb=9000.0)
        self.notices: list[Notice] = []
        self.events: list[GatewayEvent] = []
        storage = Storage(path=Path("gateway.sqlite"), warn_free_mb=500.0)
        self.watch = StoreWatch(lambda: self.health, storage, self.clock, 5.0, self.notices.append, self.events.append)

    def told(self) -> list[tuple[str, bool]]:
        return [(notice.text, notice.ended) for notice in self.notices]


async def test_a_failure_is_reported_once_published_as_long_as_it_lasts_and_its_end_reported() -> None:
    at = WatchedStore()
    async with running(at.watch.run()):
        await at.clock.run_until(20.0)
        assert at.events == []
        assert at.notices == []
        at.health = StoreHealth(plain(FULL), 3.0, waiting=20, free_mb=9000.0)
        await at.clock.run_until(40.0)
        at.health = StoreHealth(free_mb=9000.0)
        await at.clock.run_until(60.0)
    (began, _), (ended, is_end) = at.told()
    assert began.startswith(f"storage: gateway.sqlite: {FULL}; rows wait in memory")
    assert (ended, is_end) == ("storage: gateway.sqlite is written again", True)
    assert len(at.events) == 5
    assert at.events[-1] == StorageChanged(at.health)


async def test_a_disk_that_fills_up_is_reported_before_it_is_full_and_once() -> None:
    at = WatchedStore()
    async with running(at.watch.run()):
        for until, free_mb in ((10.0, 510.0), (20.0, 499.0), (30.0, 550.0), (40.0, 480.0), (200.0, 700.0)):
            at.health = StoreHealth(free_mb=free_mb)
            await at.clock.run_until(until)
    (began, _), (ended, is_end) = at.told()
    assert began.startswith("storage: 499 MB are free on the disk of gateway.sqlite, less than 500: delete")
    assert (ended, is_end) == ("storage: 700 MB are free on the disk of gateway.sqlite again", True)


async def test_a_disk_whose_space_is_unknown_is_no_problem() -> None:
    at = WatchedStore()
    at.health = StoreHealth(free_mb=None)
    async with running(at.watch.run()):
        await at.clock.run_until(20.0)
    assert at.told() == []


async def test_what_became_of_a_damaged_database_is_reported_once() -> None:
    at = WatchedStore()
    text = "storage: gateway.sqlite was damaged (malformed) and is set aside as gateway.sqlite.damaged-20260302T060000"
    async with running(at.watch.run()):
        await at.clock.run_until(10.0)
        at.health = StoreHealth(free_mb=9000.0, mended=plain(text))
        await at.clock.run_until(60.0)
    assert at.told() == [(text, False)]
