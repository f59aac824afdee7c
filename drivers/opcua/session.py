"""One OPC UA session: batch reads and writes by node name, with the library's errors raised as ours."""

import asyncio
import logging
import socket
import struct
from collections.abc import AsyncIterator, Awaitable, Mapping
from contextlib import asynccontextmanager, suppress
from typing import TypeVar

from asyncua.client.client import Client
from asyncua.client.ua_client import UaClientState
from asyncua.crypto.security_policies import (
    SecurityPolicy,
    SecurityPolicyAes128Sha256RsaOaep,
    SecurityPolicyAes256Sha256RsaPss,
    SecurityPolicyBasic256Sha256,
)
from asyncua.ua.attribute_ids import AttributeIds
from asyncua.ua.uaerrors import UaError, UaStatusCodeError
from asyncua.ua.uaprotocol_auto import MessageSecurityMode
from asyncua.ua.uatypes import DataValue, Int16, NodeId, StatusCode, String, Variant, VariantType

from drivers.base import BadAnswer, ConnectError, DriverError, NoAnswer, Refused, SetupError, WrongDevice
from drivers.credential_files import secret_in
from drivers.error_words import in_words
from drivers.opcua.answers import MOST_NODES, NAMESPACES, SERVER_TIME, count_in, names_in, node_id, node_value, time_in
from drivers.opcua.certificates import application_uri, check_key, valid_certificate
from drivers.opcua.nodes import NO_NAMESPACE, NodeName, NodeValue, moved
from drivers.opcua.settings import OpcUaServer, with_port
from drivers.opcua.status_codes import CERTIFICATE, DENIED, LOST, TOO_MANY, UNKNOWN_NODE
from drivers.opcua.subscription import Subscription
from drivers.text import NOTHING, Text

# Our errors report a lost connection; a handler that the service installs still receives the library's messages.
logging.getLogger("asyncua").addHandler(logging.NullHandler())

SECURE = Text("opcua_secure")
KEPT_S = 60.0
_POLICIES: Mapping[str, type[SecurityPolicy]] = {
    policy.URI.partition("#")[2]: policy
    for policy in (SecurityPolicyBasic256Sha256, SecurityPolicyAes128Sha256RsaOaep, SecurityPolicyAes256Sha256RsaPss)
}
_READS = Text("opcua_reads")
T = TypeVar("T")
OpcUaNumber = float | int | bool


class OpcUaSession:
    """A session that reads and writes numbers by node name. Never retries.

    After a ConnectError or NoAnswer the session is closed: connect again.
    """

    def __init__(
        self,
        settings: OpcUaServer,
        device: str,
        rights: Mapping[str, str],
        namespace_uri: str | None = None,
        kept_s: float = KEPT_S,
        patience_s: float = 0.0,
    ) -> None:
        """
        rights: which part of a node's name needs which right on the control; used in hints
        namespace_uri: of the nodes that are named by their path; the server must have it
        kept_s: how long the server shall keep the session without a request; see `kept_s`
        patience_s: how long one answer may take, if longer than the settings' timeout; one that takes longer does not
            end the session
        """
        self._settings, self._limit_s = settings, max(settings.timeout_s, patience_s)
        self._device = device
        self._rights = rights
        self._client: Client | None = None
        self._namespace_uri = namespace_uri
        self._asked_s = self._kept_s = kept_s
        self._namespace = 0
        self._namespaces: list[str] = []
        self._known: dict[int, str] = {}
        """URI of each namespace index in use, as it was at the first connection."""
        self._most_nodes = 0
        """How many nodes the server reads in one request; 0: it states no limit."""
        self._nodes: dict[tuple[str, ...], list[NodeId]] = {}
        self._subscriptions: dict[tuple[str, ...], Subscription | None] = {}

    async def connect(self) -> None:
        """Open the session and look up the namespace.

        Raises ConnectError when no server listens, Refused for the user or certificate, WrongDevice when the namespace
        is missing, SetupError when a file cannot be read.
        """
        await self.close()
        try:
            async with self._malformed_is_bad(Text("opcua_opens")):
                await self._connect()
        except BaseException:  # also when cancelled: a session without its namespaces would read other nodes
            await self.close()
            raise

    async def _connect(self) -> None:
        settings = self._settings
        looks_s = self._asked_s / 2 if self._limit_s > settings.timeout_s else max(self._limit_s, 5.0)
        client = Client(with_port(settings.url), timeout=self._limit_s, watchdog_intervall=looks_s)
        client.nodes.server_state = client.nodes.namespace_array  # what it looks at; some may not read the state
        client.name = "talc-gateway"
        client.session_timeout = round(self._asked_s * 1e3)
        if settings.user and settings.password_file is not None:
            client.set_user(settings.user)
            client.set_password(secret_in("password_file", settings.password_file, self._device))
        if settings.security != "none":
            await self._secure(client)
        try:
            await client.connect()
        except (UaError, OSError, TimeoutError, AssertionError) as error:
            raise self._unreachable(error) from error
        except Exception as error:  # the library decodes the server's answers without checking them
            raise self._unreadable(error, Text("opcua_opens")) from error
        finally:
            if client.state is not UaClientState.CONNECTED:
                await _drop(client)
        self._client, self._kept_s = client, client.session_timeout * 1e-3  # as the server has revised it
        self._nodes.clear()
        names, limit = await self._read([NAMESPACES, MOST_NODES], Text("opcua_reads_namespaces"))
        self._namespaces = namespaces = names_in(names)
        self._most_nodes = count_in(limit) or self._most_nodes
        wanted = self._namespace_uri
        if wanted is None:
            return
        if wanted not in namespaces:
            raise WrongDevice(
                Text("opcua_no_namespace", url=settings.url, wanted=repr(wanted)),
                device=self._device,
                hint=Text("opcua_it_has", names=", ".join(map(str, namespaces or ["none"]))),
            )
        self._namespace = namespaces.index(wanted)

    @property
    def kept_s(self) -> float:
        """How long the server keeps the session without a request, as it said when the session was last opened.

        Then it shall end the session (OPC UA Part 4, CreateSession), and a request of it that the network holds for
        longer is refused.
        """
        return self._kept_s

    @property
    def is_open(self) -> bool:
        """Whether a session was opened that no error has ended since."""
        return self._client is not None and self._client.state is UaClientState.CONNECTED

    async def close(self) -> None:
        """Close the session; harmless when none is open."""
        client, self._client = self._client, None
        self._subscriptions.clear()
        if client is None:
            return
        with suppress(Exception):  # also what the library raises if the answer to the close request is malformed
            await client.disconnect()

    async def read(self, paths: tuple[str, ...]) -> list[OpcUaNumber | None]:
        """Values of several nodes, in as few requests as the server allows.

        None where the control has no good value at present. Raises WrongDevice for a node that does not exist, Refused
        for a missing right.
        """
        async with self._malformed_is_bad(Text("opcua_reads")):
            answer = await self._read(self._ids(paths))
            return [self._value(path, value) for path, value in zip(paths, answer, strict=True)]

    async def read_nodes(self, names: tuple[NodeName, ...], *, aged: bool = False) -> list[NodeValue]:
        """What the server says of these nodes, in as few requests as it allows; for a node that it does not have, too,
        and for one whose namespace index was another namespace's at the first connection.

        aged: state how old the values are, by the server's own clock
        """
        async with self._malformed_is_bad(Text("opcua_reads")):
            strange = {name: value for name in names if (value := self._moved(name)) is not None}
            asked = [name for name in names if name not in strange]
            known = {name: node for name in asked if (node := node_id(name, self._namespaces)) is not None}
            answer = await self._read([*known.values(), *([SERVER_TIME] if aged else [])])
            now = time_in(answer.pop()) if aged else None
            found = strange | {name: node_value(data, now) for name, data in zip(known, answer, strict=True)}
            return [found.get(name, NO_NAMESPACE) for name in names]

    def by_uri(self, name: NodeName) -> NodeName:
        """The node named by the URI of its namespace, if that has one at this server; the index may change."""
        uri = self._uri(name.namespace) if isinstance(name.namespace, int) else ""
        return NodeName(name.identifier, uri) if uri else name

    def _uri(self, index: int) -> str:
        return self._namespaces[index] or "" if 0 < index < len(self._namespaces) else ""

    def _moved(self, name: NodeName) -> NodeValue | None:
        index = name.namespace
        if isinstance(index, str) or not index:
            return None
        uri = self._uri(index)
        known = self._known.setdefault(index, uri) if uri else self._known.get(index, "")
        return None if known == uri else moved(index, known, uri)

    async def _read(self, nodes: list[NodeId], what: str = _READS) -> list[DataValue]:
        """Their values, in parts if the server limits how many it reads at once, whether it states that or not."""
        client, found = self._open(), list[DataValue]()
        while len(found) < len(nodes):
            most = self._most_nodes or len(nodes)
            part = nodes[len(found) : len(found) + most]
            try:
                answer = await self._ask(client.uaclient.read_attributes(part, AttributeIds.Value), what)
            except BadAnswer as error:
                if len(part) == 1 or getattr(error.__cause__, "code", None) != TOO_MANY:
                    raise
                self._most_nodes = (len(part) + 1) // 2
                continue
            self._expect(len(part), answer, "values")
            found += answer
        return found

    async def subscribe(self, paths: tuple[str, ...], interval_s: float) -> bool:
        """Subscribe to changes of these nodes until the session ends; False when the server refuses."""
        subscription = Subscription(self._open(), self._ids(paths), interval_s)
        async with self._malformed_is_bad(Text("opcua_subscribes")):
            started = await self._ask(subscription.start(), Text("opcua_subscribes"))
        self._subscriptions[paths] = subscription if started else None
        return started

    async def latest(self, paths: tuple[str, ...]) -> list[OpcUaNumber | None]:
        """Like `read`, but without a request while a subscription to the same nodes is alive."""
        subscription = self._subscriptions.get(paths)
        values = subscription.latest() if subscription is not None else None
        if values is None:
            return await self.read(paths)
        async with self._malformed_is_bad(Text("opcua_takes")):
            return [self._value(path, value) for path, value in zip(paths, values, strict=True)]

    async def write(self, values: Mapping[str, float]) -> None:
        """Set several nodes in one request.

        Raises Refused naming the first node that was not set; the others may have been set.
        """
        client = self._open()
        paths = tuple(values)
        data = [DataValue(Variant(float(v), VariantType.Double)) for v in values.values()]
        request = client.uaclient.write_attributes(self._ids(paths), data, AttributeIds.Value)
        async with self._malformed_is_bad(Text("opcua_writes")):
            answer = await self._ask(request, Text("opcua_writes"), reset=True)
            self._expect(len(paths), answer, "statuses")
            for path, status in zip(paths, answer, strict=True):
                if not status.is_good():
                    raise self._bad_status(path, status, "write")

    def _open(self) -> Client:
        if self._client is None:
            raise ConnectError(
                Text("opcua_no_session", url=self._settings.url), device=self._device, hint=Text("connect_first")
            )
        return self._client

    def _ids(self, paths: tuple[str, ...]) -> list[NodeId]:
        if paths not in self._nodes:
            self._nodes[paths] = [NodeId(String(path), Int16(self._namespace)) for path in paths]
        return self._nodes[paths]

    @asynccontextmanager
    async def _malformed_is_bad(self, what: str) -> AsyncIterator[None]:
        """The library decodes answers without checking them: what it raises on a malformed one becomes BadAnswer.

        The session is then closed, because its state can no longer be trusted.
        """
        try:
            yield
        except DriverError:
            raise
        except Exception as error:
            await self.close()
            raise self._unreadable(error, what) from error

    def _expect(self, count: int, answer: object, of: str) -> None:
        """Raises BadAnswer unless the answer is a list of that length."""
        if not isinstance(answer, list) or len(answer) != count:
            found = len(answer) if isinstance(answer, list) else "no"
            raise BadAnswer(Text("opcua_count", n=found, of=of, count=count), device=self._device)

    async def _ask(self, request: Awaitable[T], what: str, *, reset: bool = False) -> T:
        """reset: a request without an answer shall not arrive later, as far as this computer can prevent it."""
        try:
            return await request
        except (UaError, OSError, TimeoutError) as error:
            if reset and isinstance(error, TimeoutError) and self._client is not None:
                _reset(self._client)
            is_late = isinstance(error, TimeoutError) and self._limit_s > self._settings.timeout_s
            if not is_late and (not isinstance(error, UaStatusCodeError) or error.code in LOST):
                await self.close()
            raise self._translated(error, what) from error

    def _value(self, path: str, value: DataValue) -> OpcUaNumber | None:
        status = value.StatusCode
        if status is not None and not status.is_good():
            if status.value in UNKNOWN_NODE or status.value in DENIED:
                raise self._bad_status(path, status, "read")
            return None
        number = value.Value.Value if value.Value is not None else None
        return number if isinstance(number, (int, float)) else None

    def _bad_status(self, path: str, status: StatusCode, verb: str) -> DriverError:
        if status.value in UNKNOWN_NODE:
            return WrongDevice(
                Text("opcua_absent", path=path, status=status.name),
                device=self._device,
                hint=Text("opcua_compare_path"),
            )
        right = next((f"{right}{verb.capitalize()}" for part, right in self._rights.items() if part in path), "")
        who = Text("user", user=repr(self._settings.user)) if self._settings.user else Text("opcua_anonymous")
        return Refused(
            Text("opcua_denied", verb=verb, path=path, status=status.name),
            device=self._device,
            hint=Text("opcua_give_right", who=who, right=right) if right else "",
        )

    def _translated(self, error: Exception, what: str) -> DriverError:
        """Our error for a library error in an open session."""
        if isinstance(error, TimeoutError):
            silent = Text("opcua_no_answer", timeout_s=self._limit_s, what=what)
            return NoAnswer(silent, device=self._device, hint=Text("opcua_slow"))
        if isinstance(error, UaStatusCodeError) and error.code not in LOST:
            kind = Refused if error.code in DENIED else BadAnswer
            return kind(Text("opcua_answers", status=_name(error), what=what), device=self._device)
        return ConnectError(Text("opcua_lost", url=self._settings.url, why=in_words(error)), device=self._device)

    def _unreadable(self, error: Exception, what: str) -> BadAnswer:
        """Our error for an exception that is not one of the library's own."""
        return BadAnswer(
            Text("opcua_malformed", what=what, kind=type(error).__name__, error=str(error)),
            device=self._device,
        )

    def _unreachable(self, error: Exception) -> DriverError:
        """Our error for a library error while the session is being opened."""
        url, device = self._settings.url, self._device
        if isinstance(error, UaStatusCodeError):
            if error.code in DENIED:
                who = (
                    Text("user", user=repr(self._settings.user))
                    if self._settings.user
                    else Text("opcua_anonymous_access")
                )
                hint = Text("opcua_check_user")
                return Refused(Text("opcua_refuses", url=url, who=who, status=_name(error)), device=device, hint=hint)
            if error.code in CERTIFICATE and self._settings.security == "none":
                return Refused(Text("opcua_not_open", url=url, status=_name(error)), device=device, hint=SECURE)
            if error.code in CERTIFICATE:
                hint = Text("opcua_check_certificate")
                return Refused(
                    Text("opcua_refuses_certificate", url=url, status=_name(error)), device=device, hint=hint
                )
        elif isinstance(error, UaError):
            hint = SECURE if self._settings.security == "none" else NOTHING
            return Refused(Text("opcua_no_such_session", url=url, why=in_words(error)), device=device, hint=hint)
        if isinstance(error, AssertionError):  # the library raises this when the server refuses the channel
            hint = Text("opcua_trust")
            return Refused(
                Text("opcua_refuses_channel", url=url),
                device=device,
                hint=hint,
            )
        if isinstance(error, TimeoutError):
            hint = Text("opcua_is_server")
            if self._settings.security != "none":
                hint = Text("opcua_server_certificate")
            return NoAnswer(Text("opcua_silent", url=url, timeout_s=self._limit_s), device=device, hint=hint)
        return self._cannot_open(error)

    def _cannot_open(self, error: Exception) -> ConnectError:
        settings = self._settings
        hint = Text("opcua_running")
        if isinstance(error, UaStatusCodeError):  # it answers
            hint = Text("opcua_ends")
            if settings.server_certificate is not None:
                hint = Text("opcua_renewed")
        return ConnectError(
            Text("opcua_cannot_open", url=settings.url, why=in_words(error)), device=self._device, hint=hint
        )

    async def _secure(self, client: Client) -> None:
        settings = self._settings
        ours = valid_certificate(settings.certificate, "certificate", self._device)
        check_key(ours, settings.private_key, self._device)
        client.application_uri = application_uri(ours, settings.certificate, self._device)
        theirs = None
        if settings.server_certificate is not None:
            valid_certificate(settings.server_certificate, "server_certificate", self._device)
            theirs = str(settings.server_certificate)
        try:
            await client.set_security(
                _POLICIES[settings.security],
                certificate=str(settings.certificate),
                private_key=str(settings.private_key),
                server_certificate=theirs,
            )
        except (ConnectionError, TimeoutError) as error:
            raise self._unreachable(error) from error
        except UaError as error:
            raise Refused(
                Text("opcua_no_security", url=settings.url, policy=settings.security, offered=await _offered(client)),
                device=self._device,
                hint=Text("opcua_switch_on"),
            ) from error
        except (OSError, ValueError, TypeError) as error:
            raise SetupError(
                Text("file_useless", path=str(settings.private_key), why=in_words(error)),
                field=("private_key",),
                device=self._device,
            ) from error


async def _offered(client: Client) -> str:
    """The policies of a server and how it uses them, in words."""
    try:
        endpoints = await client.connect_and_get_server_endpoints()
    except Exception:  # noqa: BLE001 - it was asked only to say more; the library decodes answers without checking them
        return "?"
    modes = {(str(e.SecurityPolicyUri).partition("#")[2], MessageSecurityMode(e.SecurityMode)) for e in endpoints}
    return ", ".join(sorted(f"{policy} {mode.name.rstrip('_')}" for policy, mode in modes)) or "?"


async def _drop(client: Client) -> None:
    """Close the socket of a session that was never established, left open by a cancelled or failed `connect`."""
    if client.uaclient.has_transport:
        client.disconnect_socket()
        await asyncio.sleep(0)  # the transport closes in the loop's next round


def _reset(client: Client) -> None:
    """Close the socket by a reset: what it has not sent yet is discarded, and the server drops what it has not read."""
    protocol = client.uaclient.protocol
    if protocol is None or protocol.transport is None:
        return
    sock = protocol.transport.get_extra_info("socket")
    if sock is not None:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    protocol.transport.abort()


def _name(error: UaStatusCodeError) -> str:
    return type(error).__name__
