"""A connection to a server that can be cut, go silent while it stays open, or corrupt the server's answers."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field


@dataclass
class CutWire:
    """Passes on a connection between client and server; it can be cut, or go silent while it stays open."""

    target: int
    silent: bool = False
    reset: bool = False
    """The client has closed its side by a reset."""
    spoil: Callable[[bytes], bytes] | None = None
    """Changes what the server answers."""
    delay: Callable[[bytes], float] | None = None
    """How many seconds later a message of the client reaches the server, even if the client has left meanwhile."""
    _writers: list[asyncio.StreamWriter] = field(default_factory=list)
    _tasks: set[asyncio.Task[None]] = field(default_factory=set)
    _server: asyncio.Server | None = None

    async def open(self) -> str:
        self._server = await asyncio.start_server(self._join, "127.0.0.1", 0)
        return f"opc.tcp://127.0.0.1:{self._server.sockets[0].getsockname()[1]}"

    async def _join(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        onward_reader, onward_writer = await asyncio.open_connection("127.0.0.1", self.target)
        self._writers += [writer, onward_writer]
        for source, sink, answers in ((reader, onward_writer, False), (onward_reader, writer, True)):
            task = asyncio.create_task(self._pass_on(source, sink, answers))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _pass_on(self, source: asyncio.StreamReader, sink: asyncio.StreamWriter, answers: bool) -> None:
        try:
            while data := await source.read(65536):
                if not answers and self.delay is not None and (late_s := self.delay(data)) > 0:
                    await asyncio.sleep(late_s)
                if not self.silent:
                    sink.write(self.spoil(data) if answers and self.spoil is not None else data)
        except ConnectionResetError:
            self.reset |= not answers
        sink.close()

    async def cut(self) -> None:
        for writer in self._writers:
            writer.close()
        await asyncio.gather(*(writer.wait_closed() for writer in self._writers), return_exceptions=True)
        await asyncio.gather(*self._tasks, return_exceptions=True)
        self._writers.clear()

    def abort(self) -> None:
        """Cut at once, without a word to either side."""
        for writer in self._writers:
            writer.transport.abort()

    def forget(self) -> None:
        """What is open stays open, and nothing passes through it again; new connections do."""
        for task in self._tasks:
            task.cancel()

    async def close(self) -> None:
        if self._server is not None:
            self._server.close()
        await self.cut()


@asynccontextmanager
async def wire_to(url: str) -> AsyncIterator[tuple[CutWire, str]]:
    wire = CutWire(int(url.rsplit(":", 1)[1]))
    joined = await wire.open()
    try:
        yield wire, joined
    finally:
        await wire.close()
