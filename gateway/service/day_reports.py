"""Answers queries on `report`: the page of one day, made in a separate process."""

import asyncio
import gzip
import resource
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Coroutine
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.runtime.workers.process import WorkError, in_process
from gateway.telemetry.answers import ReportPage
from gateway.telemetry.report_queries import ReportRequest

_MOST_BYTES = 3_000_000
"""Largest size of a page, as it is forwarded."""
_MOST_KEPT = 8
"""Pages of about 0.3 MB each."""
_LIMIT_S = 120.0
_MEMORY = 512 << 20
"""Most memory of the process: beyond it, it ends by itself instead of exhausting the computer."""
_FRESH_S = 60.0
"""How long the page of a day that is not over is used again."""
_STORED_WITHIN = timedelta(minutes=30)
"""Time from the end of a day until nothing more of it is stored."""


def made(database: Path, asked: ReportRequest) -> bytes:
    """The page of a day, HTML compressed with gzip; runs in a separate process. Raises StoreError, ValueError."""
    resource.setrlimit(resource.RLIMIT_DATA, (_MEMORY, _MEMORY))
    from gateway.reporting.page import build
    from gateway.service.report_data import Reader, collect, empty_page  # loads what draws: never in the gateway itself

    reader = Reader(_zone(asked.zone), day=asked.day, language=asked.language, tolerance_um=asked.tolerance_um)
    page = (empty_page(database, reader) or build(collect(database, reader=reader))).encode()
    if len(page) > _MOST_BYTES:
        raise ValueError(f"the page of {asked.day} has {len(page) / 1e6:.1f} MB, more than {_MOST_BYTES / 1e6:g} MB")
    return gzip.compress(page)


def _zone(name: str) -> ZoneInfo | None:
    """Raises ValueError for a name that this computer does not know."""
    try:
        return ZoneInfo(name) if name else None
    except (LookupError, ValueError, OSError):
        raise ValueError(
            f"zone = {name!r}: unknown on the gateway's computer; expected one like Europe/Zurich"
        ) from None


async def _made_apart(database: Path, asked: ReportRequest) -> bytes:
    """The same, made in a separate process. Raises WorkError."""
    return await in_process(made, database, asked)


class DayReports:
    """Makes one page after the other for one thread, which waits; those of days that are over are kept.

    Parameters
    ----------
    database: that the gateway writes
    now: the gateway's UTC
    make: gives a compressed page of a database; raises WorkError
    monotonic_s: real seconds
    limit_s: how long a page may take
    missing: what a page needs and is not installed; None: nothing
    """

    def __init__(
        self,
        database: Path,
        now: Callable[[], datetime],
        make: Callable[[Path, ReportRequest], Coroutine[Any, Any, bytes]] = _made_apart,
        monotonic_s: Callable[[], float] = time.monotonic,
        limit_s: float = _LIMIT_S,
        missing: Text | None = None,
    ) -> None:
        self._limit_s, self._missing = limit_s, missing
        self._database, self._now, self._make, self._monotonic_s = database, now, make, monotonic_s
        self._kept: OrderedDict[ReportRequest, tuple[float | None, bytes]] = OrderedDict()
        """With the monotonic time at which it was made; None: the day was over."""
        self._guard = threading.Lock()
        self._closed = False
        self._stop: Callable[[], object] = lambda: None

    def __call__(self, asked: ReportRequest) -> ReportPage:
        """The page of a day. Raises ValueError for an unknown time zone, OSError when it cannot be made."""
        if self._missing:
            raise OSError(Text(NoticeCode.NO_DAY_REPORT, lack=self._missing))
        zone = _zone(asked.zone)
        return ReportPage(asked.day.isoformat(), asked.zone, self._page(asked, zone))

    def close(self) -> None:
        """End what is being made; from now on nothing is made."""
        with self._guard:
            self._closed = True
            self._stop()

    def _page(self, asked: ReportRequest, zone: ZoneInfo | None) -> bytes:
        made_s, page = self._kept.get(asked, (0.0, b""))
        if page and (made_s is None or self._monotonic_s() - made_s < _FRESH_S):
            self._kept.move_to_end(asked)
            return page
        over = self._now() > _end(asked.day, zone) + _STORED_WITHIN
        page = asyncio.run(self._made(asked))
        self._kept[asked] = (None if over else self._monotonic_s(), page)
        if len(self._kept) > _MOST_KEPT:
            self._kept.popitem(last=False)
        return page

    async def _made(self, asked: ReportRequest) -> bytes:
        work = asyncio.ensure_future(self._make(self._database, asked))
        loop = asyncio.get_running_loop()
        with self._guard:
            if self._closed:
                work.cancel()
            self._stop = lambda: loop.call_soon_threadsafe(work.cancel)
        try:
            async with asyncio.timeout(self._limit_s):
                return await work
        except asyncio.CancelledError:
            raise OSError("the gateway is stopping") from None
        except TimeoutError:
            raise OSError(f"the report of {asked.day} was not finished within {self._limit_s:g} s") from None
        except WorkError as error:
            raise OSError(f"the report of {asked.day} could not be made: {error}") from error
        finally:
            with self._guard:
                self._stop = lambda: None


def _end(day: date, zone: ZoneInfo | None) -> datetime:
    """The end of a day; without a zone, its end in the last time zone on earth."""
    last = day + timedelta(days=1 if zone else 2)
    return datetime.combine(last, datetime.min.time(), zone or UTC)
