"""An OPC UA server of another library (asyncua's own) with some variables of a drive."""

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta

from asyncua.crypto.permission_rules import User, UserRole
from asyncua.server.internal_server import InternalServer
from asyncua.server.server import Server
from asyncua.server.user_managers import UserManager
from asyncua.ua.uatypes import DataValue, DateTime, Int16, NodeId, StatusCode, String, UInt32, Variant

from simulators.nc.standard_nodes import StandardServer
from tests.benches.free_port import free_port

URI = "urn:maker:drives"
SERVER_TIME = NodeId.from_string("i=2258")
"""Server_ServerStatus_CurrentTime."""


class Anybody(UserManager):
    """Everybody may read."""

    def get_user(
        self,
        iserver: InternalServer,
        username: str | None = None,
        password: str | None = None,
        certificate: object = None,
    ) -> User:
        return User(role=UserRole.User)


class Drives:
    """A server with some variables.

    first: namespaces that have the indices before those of this server
    """

    def __init__(self, url: str = "", first: Sequence[str] = ()) -> None:
        self._first = first
        self.url = url or f"opc.tcp://127.0.0.1:{free_port()}/drives"
        self.server = Server(StandardServer(Anybody()))
        self.index = 0

    async def start(self) -> None:
        await self.server.init()
        self.server.set_endpoint(self.url)
        for namespace in self._first:
            await self.server.register_namespace(namespace)
        await self.server.register_namespace("urn:somebody:else")  # so that the index is not what one would guess
        self.index = await self.server.register_namespace(URI)
        objects = self.server.nodes.objects
        values = {
            "motor": 61.25,
            "bearing": 431,
            "axes": [1.5, 48.0],
            "name": "drive",
            "bytes": b"\0",
            "counts": [0, 1],
        }
        for name, value in values.items():
            await objects.add_variable(self.node(name), name, value)
        await self.server.start()

    def node(self, name: str) -> NodeId:
        return NodeId(String(name), Int16(self.index))

    async def set_clock(self, now: datetime) -> None:
        """Set the clock of a server that was started after `server.disable_clock()`."""
        await self.server.get_node(SERVER_TIME).write_value(now)

    async def set(
        self, name: str, value: object, status: int = 0, age_s: float | None = 0.0, now: datetime | None = None
    ) -> None:
        """age_s: of the value at the server's time `now`; None: nothing says when it was measured"""
        measured = None
        if age_s is not None:
            ago = (now or datetime.now(UTC)) - timedelta(seconds=age_s)
            measured = DateTime(ago.year, ago.month, ago.day, ago.hour, ago.minute, ago.second, tzinfo=UTC)
        data = DataValue(Variant(value), StatusCode(UInt32(status)), measured)
        await self.server.get_node(self.node(name)).write_value(data)
