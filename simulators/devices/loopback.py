"""The device's end of TCP: one loopback port and its clients."""

import asyncio
from collections.abc import Callable


class Connection(asyncio.Protocol):
    """One client; its server knows it from the moment it connects until it disconnects."""

    def __init__(self) -> None:
        self.transport: asyncio.Transport | None = None
        self.known: set[Connection] = set()
        self.forgotten = False
        """The device's end disappears silently and for good: nothing is answered any more."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        if isinstance(transport, asyncio.Transport):
            self.transport = transport

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
        """Start listening; port 0: a free one. Raises OSError when the port is taken."""
        self._server = await asyncio.get_running_loop().create_server(self._made, "127.0.0.1", port)
        return int(self._server.sockets[0].getsockname()[1])

    async def stop(self) -> None:
        """Stop listening, and disconnect every client."""
        if self._server is None:
            return
        # asyncio leaves the socket of a client open whose connection it makes after the server was closed.
        for listening in self._server.sockets:
            asyncio.get_running_loop().remove_reader(listening.fileno())
        await asyncio.sleep(0)  # a client accepted by now is a connection after this pass of the loop
        self._server.close()
        while self.connections:
            for connection in tuple(self.connections):
                connection.abort()
            await asyncio.sleep(0)
        await self._server.wait_closed()
        self._server = None

    def forget(self, forgets: bool) -> None:
        """Present clients, and those that connect until this is called with False, never get another answer."""
        self._forgets = forgets
        for connection in self.connections if forgets else ():
            connection.forgotten = True

    def _made(self) -> Connection:
        connection = self._connect()
        connection.forgotten = self._forgets
        connection.known = self.connections
        self.connections.add(connection)
        return connection
