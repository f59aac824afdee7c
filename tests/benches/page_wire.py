"""A wire between a browser and the page's server that breaks as it is told, for tests that are not asynchronous."""

import asyncio
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from tests.benches.cut_wire import CutWire


class PageWire:
    """The server's address through the wire.

    Parameters
    ----------
    wire: that is open
    loop: in which it runs, in another thread
    address: of the page, through the wire
    """

    def __init__(self, wire: CutWire, loop: asyncio.AbstractEventLoop, address: str) -> None:
        self._wire, self._loop, self.address = wire, loop, address

    def cut(self) -> None:
        """End every connection, as a proxy does that allows no long answer; new ones pass."""
        asyncio.run_coroutine_threadsafe(self._wire.cut(), self._loop).result()

    def forget(self) -> None:
        """Let nothing pass through the connections that are open, without a word; new ones pass."""
        self._loop.call_soon_threadsafe(self._wire.forget)


@contextmanager
def page_wire(address: str) -> Iterator[PageWire]:
    """A wire to the page at `http://127.0.0.1:PORT/`."""
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever)
    thread.start()
    wire = CutWire(int(address.rstrip("/").rsplit(":", 1)[1]))
    try:
        joined = asyncio.run_coroutine_threadsafe(wire.open(), loop).result()
        yield PageWire(wire, loop, f"http://127.0.0.1:{joined.rsplit(':', 1)[1]}/")
    finally:
        asyncio.run_coroutine_threadsafe(wire.close(), loop).result()
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()
