"""Sends server-sent events to each open browser; the queue of a slow browser drops the oldest."""

import asyncio
import math
from collections import deque
from collections.abc import AsyncGenerator, Callable
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Final

import msgspec

from gateway.listeners.web.audit import corrections
from gateway.listeners.web.parts import certificate_row, events
from gateway.listeners.web.sentences import SaidRow
from gateway.listeners.web.verdict import Viewpoint
from gateway.listeners.web.view import listed, shown_course, view
from gateway.model.text import json_text
from gateway.telemetry.subscriber.machine import MachineSeen
from gateway.telemetry.subscriber.site import SiteSeen

_ENCODER = msgspec.json.Encoder(enc_hook=json_text)
_FASTEST_S = 0.25
"""Between two rounds while messages come."""
_SLOWEST_S = 2.0
"""Between two while none comes. A browser that hears nothing for longer than some rounds says so."""
MOST_BROWSERS: Final = 64
_LIST_S = 1.0
"""Between two rounds of a list: it is judged as a whole, and a site has many machines."""
_MOST_WAITING = 8
_END = b""
"""Wakes a stream that has nothing more to send."""
_TOLD_S = 10.0
"""How often a browser is told this computer's time."""


class BrowserQueue:
    """Messages that wait for one browser.

    Parameters
    ----------
    most: number of messages; beyond it the oldest is dropped
    """

    def __init__(self, most: int = _MOST_WAITING) -> None:
        self._waiting, self._filled = deque[bytes](maxlen=most), asyncio.Event()

    def put(self, message: bytes) -> bool:
        """Add the newest; whether the oldest was dropped for it."""
        full = len(self._waiting) == self._waiting.maxlen
        self._waiting.append(message)
        self._filled.set()
        return full

    async def take(self) -> bytes:
        """The oldest; waits for one."""
        while not self._waiting:
            self._filled.clear()
            await self._filled.wait()
        return self._waiting.popleft()


@dataclass(slots=True, eq=False)
class Browser:
    """One open page."""

    machine: str | None
    """None: the list of all machines."""
    viewpoint: Callable[[MachineSeen], Viewpoint]
    queue: BrowserQueue = field(default_factory=BrowserQueue)
    sent: dict[str, bytes] = field(default_factory=dict)
    """The last of each kind of message: what has not changed is not sent again."""
    past: tuple[int, bool, Viewpoint] | None = None
    """State of the charts that it shows; likewise of the corrections."""
    explanations: int = 0
    due_s: float = -math.inf
    """Monotonic seconds before which a list is not judged again."""

    def send(self, kind: str, shown: object) -> None:
        """Send a part of the page if it has changed."""
        data = _ENCODER.encode(shown)
        if self.sent.get(kind) != data:
            self.sent[kind] = data
            if self.queue.put(b"event: " + kind.encode() + b"\ndata: " + data + b"\n\n"):
                self.sent.clear()  # which part was lost does not matter: all of them follow again
                self.past, self.explanations = None, 0


class Streams:
    """Sends every open browser what it shows, at most four times a second.

    Parameters
    ----------
    site: what was heard
    own_end: when the page's own certificate ends; None: it has none
    """

    def __init__(self, site: SiteSeen, own_end: datetime | None = None) -> None:
        self._own_end = own_end
        self._site, self._browsers = site, set[Browser]()
        self._changed = asyncio.Event()
        self._ended = False
        self._round: dict[tuple[str, float | None, bytes], msgspec.Raw] | None = None
        """While a round lasts, what browsers of the same viewpoint share."""

    async def run(self) -> None:
        """Until it is cancelled."""
        loop, waiting = asyncio.get_running_loop(), False

        def changed() -> None:
            nonlocal waiting
            if not waiting:  # thousands of messages a second become one call
                waiting = True
                loop.call_soon_threadsafe(self._changed.set)

        self._site.changed = changed
        try:
            while True:
                with suppress(TimeoutError):
                    await asyncio.wait_for(self._changed.wait(), _SLOWEST_S)
                self._changed.clear()
                waiting = False
                self._round = {}
                for browser in self._browsers:
                    self._refresh(browser)
                self._round = None
                await asyncio.sleep(_FASTEST_S)
        finally:
            self._site.changed = lambda: None
            self._ended = True  # an open page must not take its last state for the present one
            for browser in self._browsers:
                browser.queue.put(_END)

    def _refresh(self, browser: Browser) -> None:
        now_s = self._site.now_s()
        with self._site.machines() as machines:
            if browser.machine is None:
                if now_s < browser.due_s:
                    return  # the next round comes after at most _SLOWEST_S
                browser.due_s = now_s + _LIST_S
                shown = listed(machines, {name: browser.viewpoint(seen) for name, seen in machines.items()}, now_s)
                browser.send("list", shown)
                return
            seen = machines.get(browser.machine) or MachineSeen(browser.machine)
            viewpoint = browser.viewpoint(seen)
            browser.send("view", self._view(seen, viewpoint, now_s))
            browser.send("events", tuple(events(seen)))
            if browser.explanations != seen.explanations:
                browser.explanations = seen.explanations
                browser.send("corrections", tuple(corrections(seen)))
            past = seen.past, seen.present, viewpoint  # nothing is foreseen of a gateway that is gone
            if browser.past != past:
                browser.past = past
                browser.send("course", shown_course(seen, viewpoint))

    def _view(self, seen: MachineSeen, viewpoint: Viewpoint, now_s: float) -> msgspec.Raw:
        key = seen.machine, viewpoint.tolerance_um, viewpoint.matrix.tobytes()
        shared = {} if self._round is None else self._round
        if key not in shared:
            shared[key] = msgspec.Raw(_ENCODER.encode(view(seen, viewpoint, now_s, self._own_rows())))
        return shared[key]

    def first(self, browser: Browser) -> bytes:
        """What `messages` would send at once, but for the corrections: a JSON object by kind of message, in order."""
        self._refresh(browser)
        shown = {kind: msgspec.Raw(data) for kind, data in browser.sent.items() if kind != "corrections"}
        return _ENCODER.encode({"tick": self._now_ms(), **shown})

    def _own_rows(self) -> tuple[SaidRow, ...]:
        """Rows on the health of the page itself."""
        if self._own_end is None:
            return ()
        return (certificate_row("[tls] certificate", self._own_end, datetime.now(UTC)),)

    def _now_ms(self) -> int:
        """This computer's time, UTC milliseconds: the browser's may be wrong."""
        return round(self._site.now().timestamp() * 1e3)

    def _tick(self) -> bytes:
        return b"event: tick\ndata: %d\n\n" % self._now_ms()

    @property
    def full(self) -> bool:
        """Whether no other browser is served."""
        return len(self._browsers) >= MOST_BROWSERS

    @staticmethod
    async def refusal() -> AsyncGenerator[bytes, None]:
        """What a browser is told when it is full: a script cannot read why a server refuses a stream."""
        yield b"event: full\ndata: %d\n\n" % MOST_BROWSERS

    async def messages(self, browser: Browser) -> AsyncGenerator[bytes, None]:
        """What this browser is sent, until it closes the page or `run` ends."""
        self._browsers.add(browser)
        try:
            clock = asyncio.get_running_loop().time
            told_s = clock()
            yield self._tick()
            self._refresh(browser)
            while not self._ended:
                try:
                    message = await asyncio.wait_for(browser.queue.take(), _SLOWEST_S)
                except TimeoutError:
                    message = b""
                if not message or clock() - told_s > _TOLD_S:
                    told_s = clock()
                    message = self._tick() + message
                if not self._ended:
                    yield message
        finally:
            self._browsers.discard(browser)
