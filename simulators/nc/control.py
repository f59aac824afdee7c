"""The emulated control on the wire: an OPC UA server that only maps the NC kernel's variables to nodes."""

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from datetime import datetime
from typing import Protocol

from asyncua import ua
from asyncua.common.callback import CallbackType, ServerItemCallback
from asyncua.server.server import Server

from simulators.nc.access import APPLICATION_URI, Security, User, Users, only
from simulators.nc.attributes import Attributes, add_nodes
from simulators.nc.cycle import CycleSettings
from simulators.nc.nck import R_COUNT, MachineState, MachineUnderControl, Nck
from simulators.nc.nine_errors import FollowingTerms
from simulators.nc.program import LoadCase
from simulators.nc.sampler import Sampler
from simulators.nc.standard_nodes import StandardServer
from simulators.nc.subscriptions import Subscriptions
from simulators.nc.variables import variables

NAMESPACE_URI = "SinumerikVarProvider"
SHORTEST_SESSION_S = 1.0
"""Shortest session timeout that is granted. The shortest of a real control is not known."""


class SimulatedClock(Protocol):
    """The bench's time."""

    def monotonic(self) -> float: ...

    def utc(self) -> datetime: ...

    async def sleep_until(self, monotonic_s: float) -> None: ...


class EmulatedControl:
    """A SINUMERIK-like control behind OPC UA, on loopback.

    Values are computed when they are read; a task wakes, in simulated time, only for the events of the probing cycle.
    Without `users` everybody has all rights.

    Parameters
    ----------
    machine, program, cycle, seed, compensation_sign, programs, r_count, errors, ipo_s: see Nck
    clock: simulated or real time
    users: name to password and rights
    security: None speaks without any
    subscriptions: False refuses them, like a control with too many clients
    port: 0 uses a free one

    Attributes
    ----------
    out_of_service: names of the nodes whose values the control itself reports as bad
    write_protected: names of the nodes that nobody may write, whatever their rights
    sampling: False reports no more changes of subscribed nodes; their subscriptions give signs of life all the same
    before_read: awaited with the names of the nodes before a read is answered, like a control that takes its time
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
        programs: Sequence[str] = (),
        r_count: int = R_COUNT,
        errors: FollowingTerms | None = None,
        ipo_s: float = 0.01,
    ) -> None:
        self.nck = Nck(
            machine,
            program,
            cycle=cycle,
            seed=seed,
            compensation_sign=compensation_sign,
            programs=programs,
            r_count=r_count,
            errors=errors,
            ipo_s=ipo_s,
        )
        self.out_of_service: set[str] = set()
        self.write_protected: set[str] = set()
        self.sampling = True
        self.before_read: Callable[[Sequence[str]], Awaitable[None]] | None = None
        self._clock = clock
        self._anonymous = users is None
        self._users = Users(users)
        self._security = security
        self._subscriptions = subscriptions
        self._port = port
        self._server: Server | None = None
        self._standard: StandardServer | None = None
        self._tasks: list[asyncio.Task[None]] = []
        self._wake = asyncio.Event()

    async def start(self) -> str:
        """Listen on loopback; returns the URL."""
        standard = StandardServer(self._users)
        server = Server(standard)
        await server.init()
        server.iserver.min_session_timeout_ms = SHORTEST_SESSION_S * 1e3
        server.disable_clock()  # a task that only publishes the time and delays stopping by a second
        server.set_server_name("emulated SINUMERIK")
        server.set_endpoint(f"opc.tcp://127.0.0.1:{self._port}")
        await server.set_application_uri(APPLICATION_URI)
        if self._security is None:
            server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
        else:
            policies = ua.SecurityPolicyType
            server.set_security_policy(
                [
                    policies.Basic256Sha256_SignAndEncrypt,
                    policies.Aes128Sha256RsaOaep_SignAndEncrypt,
                    policies.Aes256Sha256RsaPss_SignAndEncrypt,
                ]
            )
            await server.load_certificate(self._security.certificate)
            await server.load_private_key(self._security.private_key)
            server.set_certificate_validator(only(self._security.trusted))
        tokens: list[type] = [ua.AnonymousIdentityToken if self._anonymous else ua.UserNameIdentityToken]
        server.set_identity_tokens(tokens)
        index = await server.register_namespace(NAMESPACE_URI)
        table = variables(self.nck)
        attributes = Attributes(server.iserver.aspace, index, table, self, self._users)
        server.iserver.attribute_service = attributes

        async def before_read(event: ServerItemCallback, service: object) -> None:
            if self.before_read is not None:
                await self.before_read([str(item.NodeId.Identifier) for item in event.request_params.NodesToRead])
            attributes.note_reader(event, service)

        server.subscribe_server_callback(CallbackType.PreRead, before_read)
        await add_nodes(server, index, table, self)
        if not self._subscriptions:
            server.iserver.max_subscriptions = 0
        sampler = Sampler(server, index, self)
        await server.start()
        self._server, self._standard = server, standard
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
            # The library keeps a session with subscriptions for a client that may reconnect; here none will.
            for session in list(self._server.iserver._external_sessions.values()):  # noqa: SLF001 - the library offers no other way
                await session.close_session()
            await self._server.stop()
            self._server = self._standard = None

    def now(self) -> float:
        """Simulated seconds, after everything that was due has been processed."""
        now = self._clock.monotonic()
        self.nck.advance(now)
        return now

    def state(self) -> MachineState:
        """What the machine does now."""
        return self.nck.state(self.now())

    def utc(self) -> datetime:
        return self._clock.utc()

    @property
    def subscriptions(self) -> Subscriptions:
        """Subscriptions of its clients. Raises RuntimeError unless it runs."""
        if self._standard is None:
            raise RuntimeError("the emulated control does not run: start it first")
        return self._standard.subscriptions

    @property
    def sessions(self) -> int:
        """How many sessions its clients have."""
        return 0 if self._server is None else len(self._server.iserver._external_sessions)  # noqa: SLF001 - as above

    def wake(self) -> None:
        """Tell the task that the next event may have changed."""
        self._wake.set()

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


def _port(server: Server) -> int:
    """The port taken; the library has no public way to ask for it."""
    listener = server.bserver._server if server.bserver is not None else None  # noqa: SLF001
    sockets = listener.sockets if isinstance(listener, asyncio.Server) else ()
    if not sockets:
        raise RuntimeError("the OPC UA server does not listen")
    return int(sockets[0].getsockname()[1])
