"""A line between a browser and the page's server that breaks as it is told, for tests that are not asynchronous."""

import asyncio
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from tests.benches.cut_line import CutLine


class PageLine:
    """The server's address through the line.

    Parameters
    ----------
    line: that is open
    loop: in which it runs, in another thread
    address: of the page, through the line
    """

    def __init__(self, line: CutLine, loop: asyncio.AbstractEventLoop, address: str) -> None:
        self._line, self._loop, self.address = line, loop, address

    def cut(self) -> None:
        """End every connection, as a proxy does that allows no long answer; new ones pass."""
        asyncio.run_coroutine_threadsafe(self._line.cut(), self._loop).result()

    def forget(self) -> None:
        """Let nothing pass through the connections that are open, without a word; new ones pass."""
        self._loop.call_soon_threadsafe(self._line.forget)


@contextmanager
def page_line(address: str) -> Iterator[PageLine]:
    """A line to the page at `http://127.0.0.1:PORT/`."""
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever)
    thread.start()
    line = CutLine(int(address.rstrip("/").rsplit(":", 1)[1]))
    try:
        joined = asyncio.run_coroutine_threadsafe(line.open(), loop).result()
        yield PageLine(line, loop, f"http://127.0.0.1:{joined.rsplit(':', 1)[1]}/")
    finally:
        asyncio.run_coroutine_threadsafe(line.close(), loop).result()
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()
