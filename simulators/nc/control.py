"""The emulated control on the wire: an OPC UA server that maps the NC kernel's variables to nodes, nothing else."""

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Protocol, cast

from asyncua import ua
from asyncua.common.callback import CallbackType, ServerItemCallback
from asyncua.common.utils import ServiceError
from asyncua.crypto.permission_rules import User as Session
from asyncua.crypto.permission_rules import UserRole
from asyncua.crypto.uacrypto import load_certificate
from asyncua.crypto.validator import CertificateValidatorMethod
from asyncua.server.address_space import AddressSpace, AttributeService
from asyncua.server.server import Server
from asyncua.server.user_managers import UserManager
from asyncua.ua.attribute_ids import AttributeIds
from asyncua.ua.status_codes import StatusCodes
from asyncua.ua.uatypes import DateTime, Int16, NodeId, StatusCode, String, UInt32
from cryptography import x509

from simulators.nc.cycle import CycleSettings
from simulators.nc.nck import MachineUnderControl, Nck
from simulators.nc.program import LoadCase
from simulators.nc.sampler import Sampler
from simulators.nc.variables import Right, Value, Variable, variables

NAMESPACE_URI = "SinumerikVarProvider"
APPLICATION_URI = "urn:emulated:sinumerik"
ALL_RIGHTS = frozenset(Right)
_NOBODY = Session(role=UserRole.Anonymous)


class SimulatedClock(Protocol):
    """Time as the bench runs it."""

    def monotonic(self) -> float: ...

    def utc(self) -> datetime: ...

    async def sleep_until(self, monotonic_s: float) -> None: ...


@dataclass(frozen=True, slots=True)
class User:
    """Someone the control lets in, and what for."""

    password: str
    rights: frozenset[Right] = ALL_RIGHTS


@dataclass(frozen=True, slots=True)
class Security:
    """Basic256Sha256 with SignAndEncrypt, and nothing else."""

    certificate: Path
    """The control's, .pem or .der; its application URI is APPLICATION_URI."""
    private_key: Path
    trusted: tuple[Path, ...]
    """Certificates of the clients that are let in."""


class EmulatedControl:
    """A SINUMERIK-like control behind OPC UA, on loopback.

    Values are computed when they are read; a task wakes, in simulated time, only for what the probing cycle does by
    itself. Without `users` everybody may do everything.

    Parameters
    ----------
    machine, program, cycle, seed, compensation_sign: see Nck
    clock: simulated or real time
    users: name to password and rights
    security: None speaks without any
    subscriptions: False refuses them, as a control with too many clients does
    port: 0 takes a free one
    """

    def __init__(
        self,
        machine: MachineUnderControl,
        clock: SimulatedClock,
        program: LoadCase,
        *,
        cycle: CycleSettings | None = None,
        seed: int = 0,
        compensation_sign: int = -1,
        users: Mapping[str, User] | None = None,
        security: Security | None = None,
        subscriptions: bool = True,
        port: int = 0,
    ) -> None:
        self.nck = Nck(machine, program, cycle=cycle, seed=seed, compensation_sign=compensation_sign)
        self._clock = clock
        self._users = users
        self._security = security
        self._subscriptions = subscriptions
        self._port = port
        self._server: Server | None = None
        self._tasks: list[asyncio.Task[None]] = []
        self._wake = asyncio.Event()

    async def start(self) -> str:
        """Listen on loopback; returns the URL."""
        server = Server(user_manager=_UserManager(self._users))
        await server.init()
        server.disable_clock()  # a task that only shows the time, and delays stopping by a second
        server.set_server_name("emulated SINUMERIK")
        server.set_endpoint(f"opc.tcp://127.0.0.1:{self._port}")
        await server.set_application_uri(APPLICATION_URI)
        if self._security is None:
            server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
        else:
            server.set_security_policy([ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt])
            await server.load_certificate(self._security.certificate)
            await server.load_private_key(self._security.private_key)
            server.set_certificate_validator(_trust(self._security.trusted))
        tokens: list[type] = [ua.AnonymousIdentityToken if self._users is None else ua.UserNameIdentityToken]
        server.set_identity_tokens(tokens)
        index = await server.register_namespace(NAMESPACE_URI)
        table = variables(self.nck)
        attributes = _Attributes(server.iserver.aspace, index, table, self)
        server.iserver.attribute_service = attributes
        server.subscribe_server_callback(CallbackType.PreRead, attributes.note_reader)
        await _add_nodes(server, index, table, self)
        if not self._subscriptions:
            server.iserver.max_subscriptions = 0
        sampler = Sampler(server, index)
        await server.start()
        self._server = server
        self._port = _port(server)
        self._tasks = [asyncio.create_task(self._work_off()), asyncio.create_task(sampler.run())]
        return f"opc.tcp://127.0.0.1:{self._port}"

    async def stop(self) -> None:
        """Close the server and end the task."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        self._tasks = []
        if self._server is not None:
            # The library keeps a session with subscriptions for a client that may come back; here nobody will.
            for session in list(self._server.iserver._external_sessions.values()):
                await session.close_session()
            await self._server.stop()
            self._server = None

    def now(self) -> float:
        """Simulated seconds, with everything worked off that was due."""
        now = self._clock.monotonic()
        self.nck.advance(now)
        return now

    def utc(self) -> datetime:
        return self._clock.utc()

    def wake(self) -> None:
        """Tell the task that there may be something new to wait for."""
        self._wake.set()

    def rights(self, session: Session) -> frozenset[Right]:
        """What somebody who logged in may do."""
        if self._users is None:
            return ALL_RIGHTS
        user = self._users.get(session.name or "")
        return user.rights if user is not None else frozenset()

    async def _work_off(self) -> None:
        while True:
            self._wake.clear()
            self.now()
            due = self.nck.next_event_s
            if due is None:
                await self._wake.wait()
                continue
            waits = [asyncio.ensure_future(self._clock.sleep_until(due)), asyncio.ensure_future(self._wake.wait())]
            try:
                await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
            finally:
                for wait in waits:
                    wait.cancel()
                await asyncio.gather(*waits, return_exceptions=True)


def _trust(files: tuple[Path, ...]) -> CertificateValidatorMethod:
    """Let in who shows one of the certificates, while it is valid."""

    async def validate(certificate: x509.Certificate, _: ua.ApplicationDescription) -> None:
        if certificate not in [await load_certificate(file) for file in files]:
            raise ServiceError(StatusCodes.BadCertificateUntrusted)
        if not certificate.not_valid_before_utc <= datetime.now(UTC) <= certificate.not_valid_after_utc:
            raise ServiceError(StatusCodes.BadCertificateTimeInvalid)

    return validate


class _UserManager(UserManager):
    """Checks name and password."""

    def __init__(self, users: Mapping[str, User] | None) -> None:
        self._users = users

    def get_user(
        self,
        iserver: object,  # noqa: ARG002 the library's interface
        username: str | None = None,
        password: str | None = None,
        certificate: object = None,  # noqa: ARG002
    ) -> Session | None:
        if self._users is None:
            return Session(role=UserRole.User)
        user = self._users.get(username or "")
        return Session(role=UserRole.User, name=username) if user is not None and user.password == password else None


class _Attributes(AttributeService):
    """Answers for the control's variables itself; everything else is the server's own business."""

    def __init__(
        self, aspace: AddressSpace, namespace: int, table: Mapping[str, Variable], control: EmulatedControl
    ) -> None:
        super().__init__(aspace)
        self._namespace = namespace
        self._table = table
        self._control = control
        self._reader = _NOBODY

    def note_reader(self, event: ServerItemCallback, _: object) -> None:
        """The library tells who reads only here, just before `read`."""
        self._reader = event.user

    def _variable(self, node: NodeId, attribute: AttributeIds) -> Variable | None:
        if node.NamespaceIndex != self._namespace or attribute != AttributeIds.Value:
            return None
        return self._table.get(str(node.Identifier))

    def read(self, params: ua.ReadParameters) -> list[ua.DataValue]:
        state = self._control.nck.state(self._control.now())
        rights = self._control.rights(self._reader)
        time = cast(DateTime, self._control.utc())
        results = []
        for item in params.NodesToRead:
            variable = self._variable(item.NodeId, item.AttributeId)
            if variable is None:
                results.append(self._aspace.read_attribute_value(item.NodeId, item.AttributeId))
            elif variable.readable_with not in rights:
                results.append(ua.DataValue(StatusCode=StatusCode(UInt32(StatusCodes.BadUserAccessDenied))))
            else:
                results.append(ua.DataValue(_variant(variable.read(state)), SourceTimestamp=time))
        return results

    async def write(self, params: ua.WriteParameters, user: Session = _NOBODY) -> list[StatusCode]:
        results = []
        rights = self._control.rights(user)
        for item in params.NodesToWrite:
            variable = self._variable(item.NodeId, item.AttributeId)
            if variable is None:
                results += await super().write(ua.WriteParameters(NodesToWrite=[item]), user)
            else:
                results.append(StatusCode(UInt32(self._write(variable, item.Value, rights))))
        self._control.wake()
        return results

    def _write(self, variable: Variable, value: ua.DataValue, rights: frozenset[Right]) -> int:
        if variable.write is None:
            return int(StatusCodes.BadNotWritable)
        if variable.writable_with not in rights:
            return int(StatusCodes.BadUserAccessDenied)
        if value.Value is None or value.Value.VariantType is not ua.VariantType.Double:
            return int(StatusCodes.BadTypeMismatch)
        variable.write(value.Value.Value, self._control.now())
        return int(StatusCodes.Good)


def _port(server: Server) -> int:
    """The port taken; the library has no public way to ask for it."""
    listener = server.bserver._server if server.bserver is not None else None
    sockets = listener.sockets if isinstance(listener, asyncio.Server) else ()
    if not sockets:
        raise RuntimeError("the OPC UA server does not listen")
    return int(sockets[0].getsockname()[1])


def _variant(value: Value) -> ua.Variant:
    match value:
        case bool():
            return ua.Variant(value, ua.VariantType.Boolean)
        case int():
            return ua.Variant(value, ua.VariantType.UInt32)
        case _:
            return ua.Variant(float(value), ua.VariantType.Double)


async def _add_nodes(server: Server, index: int, table: Mapping[str, Variable], control: EmulatedControl) -> None:
    """The same variables as nodes, so that clients can browse and monitor them."""

    def value_of(variable: Variable) -> Callable[[NodeId, AttributeIds], ua.DataValue]:
        return lambda _node, _attribute: ua.DataValue(_variant(variable.read(control.nck.state(control.now()))))

    folder = await server.nodes.objects.add_folder(_node_id("/Sinumerik", index), "Sinumerik")
    for path, variable in table.items():
        node = await folder.add_variable(_node_id(path, index), path, 0.0)
        server.set_attribute_value_callback(node.nodeid, value_of(variable))


def _node_id(path: str, index: int) -> NodeId:
    return NodeId(String(path), Int16(index))
