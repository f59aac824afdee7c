"""The device's end of TCP: one loopback port and its clients."""

import asyncio
from collections.abc import Callable


class Connection(asyncio.Protocol):
    """One client; it is known to its server from the moment it comes until it goes."""

    def __init__(self) -> None:
        self.transport: asyncio.Transport | None = None
        self.known: set[Connection] = set()
        self.forgotten = False
        """The device's end is gone without a word and never comes back: whatever comes is not answered."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        if isinstance(transport, asyncio.Transport):
            self.transport = transport
            self.known.add(self)

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002 - asyncio's interface
        self.known.discard(self)

    def abort(self) -> None:
        if self.transport is not None:
            self.transport.abort()


class LoopbackServer:
    """Makes a connection with `connect` for every client. `await start()` gives the port's number."""

    def __init__(self, connect: Callable[[], Connection]) -> None:
        self._connect = connect
        self._server: asyncio.Server | None = None
        self.connections: set[Connection] = set()
        self._forgets = False

    async def start(self, port: int = 0) -> int:
        """Port 0: one that is free. Raises OSError when the port is taken."""
        self._server = await asyncio.get_running_loop().create_server(self._made, "127.0.0.1", port)
        return int(self._server.sockets[0].getsockname()[1])

    async def stop(self) -> None:
        """Nobody listens any more, and every client is cut off."""
        if self._server is None:
            return
        self._server.close()
        for connection in tuple(self.connections):
            connection.abort()
        await self._server.wait_closed()
        self._server = None
        await asyncio.sleep(0)

    def forget(self, forgets: bool) -> None:
        """Who is connected now, and who connects until this is called with False, is never answered any more."""
        self._forgets = forgets
        for connection in self.connections if forgets else ():
            connection.forgotten = True

    def _made(self) -> Connection:
        connection = self._connect()
        connection.forgotten = self._forgets
        connection.known = self.connections
        return connection
