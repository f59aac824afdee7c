"""A listening socket that strangers cannot fill: whom nobody knows yet has few places, for a short time."""

import asyncio
import gc
import logging
import socket
import time
from asyncio.sslproto import SSLProtocol
from collections import Counter
from contextlib import suppress
from weakref import WeakSet

from drivers.section import host_and_port
from gateway.model.codes import NoticeCode
from gateway.model.text import Text

log = logging.getLogger(__name__)

SSLProtocol.max_size = 2**14
"""Bytes, for a record of TLS: with asyncio's own number a stranger holds 256 kB before its first byte has come."""
MOST_STRANGERS = 32
"""Connections."""
FIRST_REQUEST_S = 10.0
"""How long one may stay a stranger."""
_WAITING = 128
"""Connections that the kernel holds meanwhile; they cost no descriptor."""

_PAUSE_S = 0.002
"""Before one that takes another's place: those that are there get on meanwhile, and a flood takes no processor."""
_ENDED_BETWEEN = 64
"""Strangers that are ended between two garbage collections."""
_TOLD_EVERY_S = 60.0
ACCEPTED_AT_ONCE = 1
"""What to give asyncio as `backlog`: so many are accepted before the others are looked at."""

Peer = tuple[str, int]


class GuardedSocket(socket.socket):
    """Listens for a server of asyncio, which accepts through it, in the loop's thread.

    A connection is a stranger's until `know` is told of its peer. When there are too many strangers, one makes place
    for the next: of the address that has most of them, the one that has been connected longest. So whoever sends its
    request at once is served, however many do not.

    Parameters
    ----------
    host, port: where; port 0 takes a free one
    strangers: how many there may be
    known: how many of the others; more stay strangers
    first_request_s: how long one may stay a stranger

    Raises OSError, which names no address.
    """

    def __init__(
        self,
        host: str,
        port: int,
        *,
        strangers: int = MOST_STRANGERS,
        known: int = 200,
        first_request_s: float = FIRST_REQUEST_S,
    ) -> None:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        super().__init__(family, kind, protocol)
        self._most_strangers, self._most_known, self._first_request_s = strangers, known, first_request_s
        self._strangers: dict[Peer, tuple[socket.socket, asyncio.TimerHandle]] = {}
        """The one that came first is the first."""
        self._known: dict[Peer, socket.socket] = {}
        self._all = WeakSet[socket.socket]()
        self._ended = self._displaced = 0
        self._telling = False
        try:
            self.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self.bind(address)
            self.listen()  # whoever follows the printed address at once waits
            self.setblocking(False)
        except OSError:
            self.close()
            raise

    @property
    def address(self) -> str:
        """Host and port."""
        return host_and_port(*self.getsockname()[:2])

    def listen(self, _: int = 0, /) -> None:
        """Also where asyncio asks for a shorter queue."""
        super().listen(_WAITING)

    def accept(self) -> tuple[socket.socket, object]:
        """The next connection, as asyncio asks for it."""
        connection, address = super().accept()
        peer: Peer = address[:2]
        self._forget_closed()
        if len(self._strangers) >= self._most_strangers:
            ((host, _),) = Counter(host for host, _ in self._strangers).most_common(1)
            self._end(next(other for other in self._strangers if other[0] == host))
            self._displaced += 1
            if not self._telling:
                self._tell()
            time.sleep(_PAUSE_S)
        timer = asyncio.get_running_loop().call_later(self._first_request_s, self._late, peer)
        self._strangers[peer] = connection, timer
        self._all.add(connection)
        return connection, address

    async def end(self) -> None:
        """End all connections. Returns when the server has closed them."""
        for peer in list(self._strangers):
            self._end(peer)
        for connection in self._all:
            with suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)
        while any(connection.fileno() >= 0 for connection in self._all):
            await asyncio.sleep(0.001)

    def know(self, peer: Peer) -> None:
        """This connection is no stranger's: a request came that was let in."""
        if peer not in self._strangers or len(self._known) >= self._most_known:
            return
        connection, timer = self._strangers.pop(peer)
        timer.cancel()
        self._known[peer] = connection

    def knows(self, peer: Peer) -> bool:
        """Whether it is no stranger's. A server that can tell by itself, and not when it happens, overrides this."""
        return peer in self._known

    def _forget_closed(self) -> None:
        for peer, (connection, timer) in list(self._strangers.items()):
            if connection.fileno() < 0:
                timer.cancel()
                del self._strangers[peer]
            elif self.knows(peer):
                self.know(peer)
        for peer in [peer for peer, connection in self._known.items() if connection.fileno() < 0]:
            del self._known[peer]

    def _tell(self) -> None:
        """How many strangers had to make place: at once of the first one, then once a minute."""
        self._telling = self._displaced > 0
        if self._telling:
            log.warning("%s", Text(NoticeCode.STRANGERS_DISPLACED, place=self.address, many=self._displaced))
            self._displaced = 0
            asyncio.get_running_loop().call_later(_TOLD_EVERY_S, self._tell)

    def _late(self, peer: Peer) -> None:
        self._forget_closed()
        if peer in self._strangers:
            self._end(peer)

    def _end(self, peer: Peer) -> None:
        """The server finds that the other side has left, and closes the connection itself.

        What is left of one by TLS are a few objects in a circle, which hold 20 kB of a library's: Python alone would
        wait for thousands of them. Call `freeze_gc` before, so that to collect them takes no time.
        """
        self._ended += 1
        if self._ended % _ENDED_BETWEEN == 0:
            gc.collect()
        connection, timer = self._strangers.pop(peer)
        timer.cancel()
        with suppress(OSError):
            connection.shutdown(socket.SHUT_RDWR)
