"""One simulated clock for the processes of a bench: scaled real time that waits for its owner's work."""

import asyncio
import math
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from mmap import ACCESS_READ, mmap
from pathlib import Path
from threading import Lock
from uuid import uuid4

_LAYOUT = struct.Struct("=Qdddd")  # sequence (odd while being written), real base, simulated base, speed, limit
_SHORTEST_SLEEP_S = 0.0005


class SharedClock:
    """Simulated seconds = base + (real - real base) * speed, at most the limit; in a small file that all processes map.

    The file's owner starts, stops and holds the clock; others only read it. The limit is the earliest time until which
    one of the owner's tasks sleeps: on a busy computer simulated time waits for the owner and does not pass it.
    CLOCK_MONOTONIC is common to all processes of a Linux machine, so no messages are exchanged while it runs.
    """

    def __init__(self, path: Path, *, epoch: datetime, speed: float = 1.0, owner: bool = False) -> None:
        self._epoch = epoch.astimezone(UTC)
        self._speed = speed
        self._holds = 0
        self._origin = uuid4().hex
        self._lock = Lock()
        self._due: list[float] = []
        """The time until which the owner's tasks sleep."""
        self._owner = owner
        if owner:
            path.write_bytes(_LAYOUT.pack(0, time.monotonic(), 0.0, 0.0, math.inf))
        with path.open("r+b" if owner else "rb") as file:
            self._map = (
                mmap(file.fileno(), _LAYOUT.size) if owner else mmap(file.fileno(), _LAYOUT.size, access=ACCESS_READ)
            )
        self._running = False

    def monotonic(self) -> float:
        while True:
            before, real_base, base, speed, limit = _LAYOUT.unpack_from(self._map)
            if before % 2 == 0 and _LAYOUT.unpack_from(self._map)[0] == before:
                now = base + (time.monotonic() - real_base) * speed
                return float(min(now, max(base, limit)))

    def utc(self) -> datetime:
        return self._epoch + timedelta(seconds=self.monotonic())

    def start(self) -> None:
        """Let simulated time run."""
        with self._lock:
            self._running = True
            self._apply()

    def stop(self) -> None:
        """Stop simulated time."""
        with self._lock:
            self._running = False
            self._apply()

    @contextmanager
    def hold(self) -> Iterator[None]:
        """Simulated time stands still inside; holds nest and may overlap between tasks and threads."""
        with self._lock:
            self._holds += 1
            self._apply()
        try:
            yield
        finally:
            with self._lock:
                self._holds -= 1
                self._apply()

    def synchronised(self) -> bool:
        """Whether the clock is right: simulated time always is."""
        return True

    def origin(self) -> str:
        """A name for this clock, which no other one has."""
        return self._origin

    async def sleep_until(self, monotonic_s: float) -> None:
        """Sleep; the owner wakes at exactly that time, others at that time or later."""
        if monotonic_s <= self.monotonic():
            return
        self._wait_for(monotonic_s)
        try:
            while (left := monotonic_s - self.monotonic()) > 0:
                await asyncio.sleep(max(left / self._speed, _SHORTEST_SLEEP_S))
        finally:
            self._wait_no_more_for(monotonic_s)

    def _wait_for(self, due_s: float) -> None:
        if self._owner:
            with self._lock:
                self._due.append(due_s)
                self._apply()

    def _wait_no_more_for(self, due_s: float) -> None:
        if self._owner:
            with self._lock:
                self._due.remove(due_s)
                self._apply()

    def close(self) -> None:
        self._map.close()

    def _apply(self) -> None:
        if not self._owner:
            raise PermissionError("only the owner of a simulated clock may start, stop or hold it")
        speed = self._speed if self._running and self._holds == 0 else 0.0
        now_simulated, now_real = self.monotonic(), time.monotonic()
        limit = min(self._due, default=math.inf)
        sequence = _LAYOUT.unpack_from(self._map)[0]
        _LAYOUT.pack_into(self._map, 0, sequence + 1, now_real, now_simulated, speed, limit)
        _LAYOUT.pack_into(self._map, 0, sequence + 2, now_real, now_simulated, speed, limit)
