"""The OPC UA server: who may connect, and what is shown each second."""

import asyncio
import logging
import socket
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from types import TracebackType
from typing import Self

from asyncua import ua
from asyncua.common.connection import TransportLimits
from asyncua.server.binary_server_asyncio import BinaryServer, OPCUAProtocol
from asyncua.server.server import Server
from asyncua.ua.uaerrors import UaError

from drivers.opcua.certificates import application_uri, check_key, valid_certificate
from drivers.section import host_and_port
from gateway.listeners.umati.model import URIS, machine_nodes
from gateway.listeners.umati.readers import Readers, calling
from gateway.listeners.umati.settings import OpcUaServing, ServerSecurity, ShownMachine
from gateway.listeners.umati.space import AddressSpace
from gateway.listeners.umati.standard import LightServer
from gateway.listeners.umati.values import NodeShown, Path, shown_now
from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.runtime.clocks import RealClock
from gateway.runtime.listening import ACCEPTED_AT_ONCE, MOST_STRANGERS, GuardedSocket, Peer
from gateway.runtime.periodic import Periodic
from gateway.runtime.problems import Problems
from gateway.runtime.versions import program_version
from gateway.telemetry.subscriber.site import SiteSeen

log = logging.getLogger(__name__)

_EVERY_S = 1.0
_MOST_KNOWN = 50
"""Connections with a session that was let in."""
_MOST_SUBSCRIPTIONS = 200
_MOST_BYTES = 1 << 20
"""Limit of what a client sends: it only asks."""
_CHUNK_BYTES = 65535
"""Limit of each part of it."""
_PROFILES = (
    "http://opcfoundation.org/UA-Profile/Server/EmbeddedUA2017",
    "http://opcfoundation.org/UA-Profile/Server/DataAccess",
)
"""OPC UA Part 7: what a client may expect; the standard's own names."""
_WHERE = "the OPC UA server"


class MachineToolServer:
    """Shows the machines of a site to OPC UA clients while it is entered, read-only.

    Parameters
    ----------
    site: what was heard
    machines: which of its machines are shown, with their nameplates
    serving: certificate and users
    host, port: where it listens; port 0 takes a free one

    Raises on entry SetupError for a certificate that cannot be used, OSError for an address that cannot.
    """

    def __init__(
        self, site: SiteSeen, machines: Mapping[str, ShownMachine], serving: OpcUaServing, host: str, port: int
    ) -> None:
        self._site, self._machines, self._serving = site, machines, serving
        self._host, self._port = host, port
        self._server: Server | None = None
        self._space: AddressSpace | None = None
        self._showing: asyncio.Task[None] | None = None
        self._problems = Problems(RealClock(), _EVERY_S, lambda _: None, log)

    async def __aenter__(self) -> Self:
        serving = self._serving
        inner = LightServer(Readers(serving.users))
        server = _GuardedServer(inner)
        inner.allow_remote_admin = False
        inner.max_connections, inner.max_subscriptions = _MOST_KNOWN + 2 * MOST_STRANGERS, _MOST_SUBSCRIPTIONS
        server.limits = TransportLimits(_CHUNK_BYTES, _CHUNK_BYTES, _MOST_BYTES // _CHUNK_BYTES + 1, _MOST_BYTES)
        await server.init()
        name = "talc-gateway"
        await server.set_build_info(f"urn:{name}", name, name, program_version(), "0", datetime.now(UTC))
        server.name = name
        first = next(iter(self._machines), "server")
        await _secure(server, serving.security, f"urn:{socket.gethostname()}:{name}:{first}")
        indexes = {space: await server.register_namespace(uri) for space, uri in URIS.items()}
        self._space = AddressSpace(inner, indexes)
        await self._space.add_types()
        await self._space.describe(_PROFILES)
        for machine, shown in self._machines.items():
            await self._space.add_machine(machine_nodes(machine, shown))
        await self.show()
        server.set_endpoint(f"opc.tcp://{host_and_port(self._host, self._port)}/")
        await server.start()
        self._server = server
        showing = Periodic(RealClock(), _EVERY_S).run(self._show_again)
        self._showing = asyncio.create_task(showing, name="opcua values")
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._showing is not None:
            self._showing.cancel()
            with suppress(asyncio.CancelledError):
                await self._showing
        if self._server is not None:
            await self._server.stop()

    @property
    def url(self) -> str:
        """Where clients connect."""
        listening = None if self._server is None else self._server.bserver
        port = self._port if listening is None else listening.port
        return f"opc.tcp://{host_and_port(self._host, port)}/"

    async def show(self) -> None:
        """What was heard until now."""
        space = self._space
        if space is None:
            return
        found: list[tuple[str, dict[Path, NodeShown], dict[str, str]]] = []
        with self._site.machines() as machines:
            now_s = self._site.now_s()
            for name in self._machines:
                seen = machines[name]
                units = {channel: message.unit for channel, message in seen.readings.items()}
                found.append((name, shown_now(seen, now_s), units))
        for name, values, units in found:
            await space.show(name, values, units)

    async def _show_again(self, _: float) -> None:
        try:
            await self.show()
        except (UaError, ValueError, TypeError) as error:
            self._problems.report("values", Text(NoticeCode.VALUES_NOT_SHOWN), type(error).__name__, bug=error)
        else:
            self._problems.clear("values", NoticeCode.VALUES_SHOWN)


class _GuardedServer(Server):
    """The library's, on a socket that strangers cannot fill: without a session they have it for a short time."""

    async def start(self) -> None:
        """Raises OSError."""
        await self._setup_server_nodes()
        await self.iserver.start()
        try:
            self.bserver = _GuardedBinaryServer(
                self.iserver, self.endpoint.hostname or "", self.endpoint.port or 0, self.limits
            )
            self.bserver.set_policies(self._policies)
            await self.bserver.start()
        except OSError:
            await self.iserver.stop()
            raise


class _GuardedBinaryServer(BinaryServer):
    async def start(self) -> None:
        """Raises OSError."""
        listening = _SessionSocket(self.hostname, self.port, known=_MOST_KNOWN)
        listening.clients = self.clients
        self.hostname, self.port = listening.getsockname()[:2]
        loop = asyncio.get_running_loop()
        self._server = await loop.create_server(self._make_protocol, sock=listening, backlog=ACCEPTED_AT_ONCE)
        self.cleanup_task = asyncio.create_task(self._close_task_loop())

    def _make_protocol(self) -> OPCUAProtocol:
        return _Connection(self.iserver, self._policies, self.clients, self.closing_tasks, self.limits)


class _Connection(OPCUAProtocol):
    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        calling.set(transport.get_extra_info("peername")[0])  # for the task that the library begins here
        super().connection_made(transport)


class _SessionSocket(GuardedSocket):
    clients: Sequence[OPCUAProtocol] = ()

    def knows(self, peer: Peer) -> bool:
        """Whether it has a session that was let in."""
        return super().knows(peer) or any(
            client.peer_name[:2] == peer
            and client.processor is not None
            and client.processor.session is not None
            and client.processor.session.is_activated()
            for client in self.clients
        )


async def _secure(server: Server, security: ServerSecurity | None, uri: str) -> None:
    """Raises SetupError. uri: of the application, where no certificate holds one; no other server has it"""
    if security is None:
        server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
        server.set_identity_tokens([ua.AnonymousIdentityToken])
        await server.set_application_uri(uri)
        return
    certificate = valid_certificate(security.certificate, "certificate", _WHERE)
    check_key(certificate, security.private_key, _WHERE)
    await server.set_application_uri(application_uri(certificate, security.certificate, _WHERE))
    await server.load_certificate(str(security.certificate))
    await server.load_private_key(str(security.private_key))
    server.set_security_policy([ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt])
    server.set_identity_tokens([ua.UserNameIdentityToken])
