"""OPC UA servers of somebody else: drawn from a seed, a few oddities at once, and played.

Written from OPC UA Part 4 and 6. Only the encoding of structures is asyncua's.
"""

import random
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from asyncua import ua
from asyncua.common.utils import Buffer
from asyncua.ua.object_ids import ObjectIds
from asyncua.ua.status_codes import StatusCodes
from asyncua.ua.ua_binary import nodeid_from_binary, struct_from_binary, struct_to_binary

from tests.benches.strangers.driven_loop import DrivenLoop, Line
from tests.benches.strangers.nature import Told
from tests.benches.strangers.nature import log_uniform as _log

URIS = ("http://opcfoundation.org/UA/", "urn:server", "urn:ours", "urn:other")
_OURS, _OTHER = 2, 3
"""Namespaces. Both have nodes of the same names."""
_OTHERS = 8
"""Added to the numbers of the other namespace's nodes."""
_SOON_S = 0.001
_APART_S = 1e-6
"""What is sent at one moment may arrive in any order."""
_EPOCH = datetime(2026, 1, 1, tzinfo=UTC)
_BOOTS_S = 1.0
"""After a restart, so long it accepts connections and says that it is halted."""
_S = StatusCodes
_TIME, _STATE, _NAMES, _MOST = (ua.NodeId.from_string(f"i={number}") for number in (2258, 2259, 2255, 11705))
_SAYS = {
    "bad": _S.BadCommunicationError,
    "uncertain": _S.UncertainLastUsableValue,
    "waiting": _S.BadWaitingForInitialData,
}


@dataclass(frozen=True)
class OpcUaNature(Told):
    """How it behaves; what is 0, none or empty does not occur. Times are seconds, shares 0 to 1."""

    nodes: int = 2
    by_index: bool = False
    """Whether the profile names the namespace by its index."""
    aged: bool = False
    """Whether the profile has a `max_age_s`."""
    period_s: float = 1.0
    timeout_s: float = 1.0
    # A connection.
    mute_s: float = 0.0
    """After a connection it swallows what comes."""
    lingers_s: float = 0.0
    """It has one client, and notices so late that it has gone; a second one is refused, never served, or has no
    session."""
    second: str = "refused"
    closes_s: float = 0.0
    closes_after: int = 0
    """Answers on one connection."""
    session_s: float = 0.0
    """After this time it knows the session no more."""
    token_s: float = 3600.0
    """How long the channel's token lives."""
    # An answer.
    took_s: float = 0.002
    jitter_s: float = 0.0
    slower: float = 0.0
    """Share of the answers that take `slower_s` longer."""
    slower_s: float = 0.0
    swallows: float = 0.0
    most: int = 0
    """It reads no more nodes in one request."""
    states_most: bool = True
    handle: str = "right"
    """Of the answer: `right`, `zero`, `next`."""
    chunks: bool = False
    """Whether an answer comes in two of them."""
    pieces_s: float = 0.0
    """Between the two parts in which an answer comes."""
    stamps: str = "right"
    """Of the values: `right`, `none`, `seconds`."""
    hides_state: bool = False
    """Whether nobody may read its state (i=2259)."""
    clock_s: float = 0.0
    """Its clock is ahead by so much."""
    # Every `every_s`, for `burst_s`:
    burst: str = ""
    """`silent`, `restarts`, `frozen` (values and timestamps stand still), `busy` (it refuses requests), `ahead` (only
    the timestamps are, by a minute), or a status of values: `bad`, `uncertain` (it has the old value), `waiting`."""
    burst_s: float = 0.0
    every_s: float = 30.0
    renumbers: bool = False
    """Whether each restart exchanges two namespaces."""


def _burst(*kinds: str) -> Callable[[random.Random], Mapping[str, object]]:
    return lambda d: {"burst": d.choice(kinds), "burst_s": _log(d, 0.3, 8.0), "every_s": d.uniform(12, 40)}


_ODDITIES: tuple[Callable[[random.Random], Mapping[str, object]], ...] = (
    lambda d: {"mute_s": _log(d, 0.05, 3.0)},
    lambda d: {"lingers_s": _log(d, 0.1, 5.0), "second": d.choice(("refused", "mute", "sessions"))},
    lambda d: {"closes_s": _log(d, 0.1, 20.0)},
    lambda d: {"closes_after": d.choice((4, 7, 12, 30))},
    lambda d: {"session_s": _log(d, 0.5, 20.0)},
    lambda d: {"token_s": _log(d, 0.5, 20.0)},
    lambda d: {"took_s": _log(d, 0.01, 0.4)},
    lambda d: {"jitter_s": _log(d, 0.01, 0.3)},
    lambda d: {"slower": _log(d, 0.02, 0.3), "slower_s": _log(d, 0.1, 3.0)},
    lambda d: {"swallows": _log(d, 0.01, 0.1)},
    lambda d: {"most": d.choice((1, 2, 3)), "states_most": d.random() < 0.5},
    lambda d: {"handle": d.choice(("zero", "next"))},
    lambda _: {"chunks": True},
    lambda d: {"pieces_s": _log(d, 0.001, 0.1)},
    lambda d: {"stamps": d.choice(("none", "seconds"))},
    lambda _: {"hides_state": True},
    lambda d: {"clock_s": d.choice((-7200.0, -40.0, 40.0, 1e8))},
    _burst("silent", "busy", "waiting"),
    _burst("frozen", "bad", "uncertain", "ahead"),
    lambda d: {**_burst("restarts")(d), "renumbers": d.random() < 0.7},
)


def drawn(draw: random.Random) -> OpcUaNature:
    """One of them."""
    plain: dict[str, object] = {
        "nodes": draw.choice((1, 2, 4)),
        "by_index": draw.random() < 0.5,
        "aged": draw.random() < 0.5,
        "period_s": draw.choice((0.5, 1.0, 1.0, 3.0)),
        "timeout_s": draw.choice((0.5, 1.0, 2.0)),
    }
    for _ in range(draw.choice((1, 1, 2, 3))):
        plain |= draw.choice(_ODDITIES)(draw)
    return OpcUaNature(**plain)  # type: ignore[arg-type]


def held(number: int, at_s: float) -> float:
    """What the node of this number holds: which one it is, and when that was measured."""
    return float(number << 24 | round(at_s * 100) % 2**24)


def told(value: float) -> int:
    """The number of its node."""
    return int(value) >> 24


def age_s(value: float, now_s: float) -> float:
    """How long ago it was measured."""
    return (round(now_s * 100) - int(value)) % 2**24 / 100


class ForeignServer:
    """One server."""

    def __init__(self, loop: DrivenLoop, nature: OpcUaNature, draw: random.Random) -> None:
        self._loop, self._is, self._draw = loop, nature, draw
        self._began_s = self._free_s = loop.time()
        self._client: Line | None = None
        self._taken_until_s = 0.0
        self._up, self._restarts = True, 0
        self._came_back_s = -1e9
        self._talks: dict[Line, _Talk] = {}
        if nature.burst == "restarts":
            loop.call_later(nature.every_s - nature.burst_s, self._restart)

    @property
    def burst(self) -> str:
        nature = self._is
        since_s = (self._loop.time() - self._began_s) % nature.every_s
        return nature.burst if nature.burst and since_s > nature.every_s - nature.burst_s else ""

    @property
    def refuses(self) -> bool:
        return not self._up or (self._is.second == "refused" and self.is_taken(None))

    def is_taken(self, line: Line | None) -> bool:
        """By another client, as far as it knows."""
        if not self._is.lingers_s or (line is not None and line is self._client):
            return False
        return self._client is not None or self._loop.time() < self._taken_until_s

    @property
    def uris(self) -> list[str]:
        """Of its namespaces."""
        exchanged = self._is.renumbers and self._restarts % 2
        return [*URIS[:_OURS], *(URIS[:1:-1] if exchanged else URIS[_OURS:])]

    def _restart(self) -> None:
        self._up = False
        for line in list(self._talks):
            line.hang_up()
        self._loop.call_later(self._is.burst_s, self._come_back)
        self._loop.call_later(self._is.every_s, self._restart)

    def _come_back(self) -> None:
        self._up, self._restarts, self._came_back_s = True, self._restarts + 1, self._loop.time()

    @property
    def boots(self) -> bool:
        return self._loop.time() < self._came_back_s + _BOOTS_S

    def connected(self, line: Line) -> None:
        if self._is.second != "sessions" and self.is_taken(line):
            return
        self._talks[line] = _Talk(self, self._loop, line, self._is, self._draw)
        if self._is.second != "sessions":
            self.take(line)
        if self._is.closes_s:
            self._loop.call_later(self._is.closes_s, line.hang_up)

    def take(self, line: Line) -> None:
        """This is its client now."""
        self._client = line

    def left(self, line: Line) -> None:
        self._talks.pop(line, None)
        if line is self._client:
            self._client, self._taken_until_s = None, self._loop.time() + self._is.lingers_s

    def heard(self, line: Line, data: bytes) -> None:
        nature, now_s = self._is, self._loop.time()
        if line not in self._talks or now_s < line.opened_s + nature.mute_s or self.burst == "silent":
            return
        self._talks[line].heard(data)

    def takes_s(self) -> float:
        """When the next answer is sent, loop time: it answers one request after the other."""
        nature, draw = self._is, self._draw
        slower_s = nature.slower_s if draw.random() < nature.slower else 0.0
        took_s = nature.took_s + draw.random() * nature.jitter_s + slower_s
        self._free_s = max(self._loop.time(), self._free_s) + took_s
        return self._free_s

    def value(self, node: ua.NodeId) -> ua.DataValue:
        """Of one node, as it is sent."""
        nature, now_s, burst = self._is, self._loop.time(), self.burst
        if node == _TIME:
            return ua.DataValue(ua.Variant(self._utc(now_s)))
        if node == _STATE:
            return ua.DataValue(
                ua.Variant(0), StatusCode=ua.StatusCode(ua.UInt32(_S.BadUserAccessDenied if nature.hides_state else 0))
            )
        if node == _NAMES:
            return ua.DataValue(ua.Variant(self.uris))
        if node == _MOST and nature.most and nature.states_most:
            return ua.DataValue(ua.Variant(nature.most, ua.VariantType.UInt32))
        number = self._number(node)
        if number is None:
            return ua.DataValue(StatusCode=ua.StatusCode(ua.UInt32(_S.BadNodeIdUnknown)))
        stands = burst in ("frozen", "uncertain")
        since_s = self._began_s + (now_s - self._began_s) // nature.every_s * nature.every_s
        at_s = since_s + nature.every_s - nature.burst_s if stands else now_s
        stamp: ua.DateTime | None = self._utc(at_s + (60.0 if burst == "ahead" else 0.0))
        if nature.stamps == "none":
            stamp = None
        elif nature.stamps == "seconds" and stamp is not None:
            stamp = stamp.replace(microsecond=0)
        status = ua.StatusCode(ua.UInt32(_SAYS.get(burst, 0)))
        value = ua.Variant(None) if burst in ("bad", "waiting") else ua.Variant(held(number, at_s))
        return ua.DataValue(value, StatusCode=status, SourceTimestamp=stamp)

    def _utc(self, at_s: float) -> ua.DateTime:
        at = _EPOCH + timedelta(seconds=at_s - self._began_s + self._is.clock_s)
        return ua.DateTime.fromtimestamp(at.timestamp(), UTC)

    def _number(self, node: ua.NodeId) -> int | None:
        name, uris = str(node.Identifier), self.uris
        is_one = name.startswith("T") and name[1:].isdecimal() and int(name[1:]) < self._is.nodes
        if not is_one or node.NamespaceIndex not in (_OURS, _OTHER):
            return None
        return int(name[1:]) + (0 if uris[node.NamespaceIndex] == URIS[_OURS] else _OTHERS)


class _Talk:
    """One connection."""

    def __init__(
        self, server: ForeignServer, loop: DrivenLoop, line: Line, nature: OpcUaNature, draw: random.Random
    ) -> None:
        self._server, self._loop, self._line, self._is, self._draw = server, loop, line, nature, draw
        self._buffer = b""
        self._sequence = self._answers = self._token = 0
        self._renewed_s = self._session_s = self._sent_s = -1e9

    def heard(self, data: bytes) -> None:
        self._buffer += data
        while len(self._buffer) >= 8 and len(self._buffer) >= (size := int.from_bytes(self._buffer[4:8], "little")):
            message, self._buffer = self._buffer[:size], self._buffer[size:]
            if self._draw.random() < self._is.swallows:
                continue
            self._loop.call_at(self._server.takes_s(), self._answer, message)

    def _answer(self, message: bytes) -> None:
        if not self._line.is_open:
            return
        kind = message[:3]
        if kind == b"HEL":
            self._send(b"ACKF" + struct.pack("<IIIIII", 28, 0, 65536, 65536, 0, 0))
        elif kind == b"OPN":
            length = struct.unpack_from("<I", message, 12)[0]
            at = 12 + 4 + length + 8
            request_id = struct.unpack_from("<I", message, at + 4)[0]
            self._token, self._renewed_s = self._token + 1, self._loop.time()
            opened = ua.OpenSecureChannelResponse()
            token = opened.Parameters.SecurityToken
            token.ChannelId, token.TokenId = ua.UInt32(1), ua.UInt32(self._token)
            token.RevisedLifetime = ua.UInt32(round(1e3 * self._is.token_s))
            self._respond(request_id, message[at + 8 :], opened, b"OPN", message[12:at])
        elif kind == b"CLO" or self._loop.time() > self._renewed_s + 1.25 * self._is.token_s:  # Part 4, 5.5.2.1
            self._line.hang_up()
        else:
            request_id = struct.unpack_from("<I", message, 20)[0]
            body = message[24:]
            self._respond(request_id, body, self._served(body))

    def _served(self, body: bytes) -> object:
        nature, server, now_s = self._is, self._server, self._loop.time()
        buffer = Buffer(body)
        asked = nodeid_from_binary(buffer).Identifier
        struct_from_binary(ua.RequestHeader, buffer)
        if asked == ObjectIds.CreateSessionRequest_Encoding_DefaultBinary:
            if server.is_taken(self._line):
                return _fault(_S.BadTooManySessions)
            if server.boots and nature.burst == "restarts":
                return _fault(_S.BadServerHalted)
            server.take(self._line)
            created = ua.CreateSessionResponse()
            created.Parameters.SessionId = ua.NodeId.from_string("ns=1;i=1")
            created.Parameters.AuthenticationToken = ua.NodeId.from_string("ns=1;i=2")
            created.Parameters.RevisedSessionTimeout = ua.Double(60_000.0)
            created.Parameters.ServerEndpoints = [_endpoint()]
            return created
        if asked == ObjectIds.ActivateSessionRequest_Encoding_DefaultBinary:
            self._session_s = now_s
            return ua.ActivateSessionResponse()
        if asked == ObjectIds.CloseSessionRequest_Encoding_DefaultBinary:
            return ua.CloseSessionResponse()
        if asked != ObjectIds.ReadRequest_Encoding_DefaultBinary:
            return _fault(_S.BadServiceUnsupported)
        if nature.session_s and now_s > self._session_s + nature.session_s:
            return _fault(_S.BadSessionIdInvalid)
        if server.burst == "busy":
            return _fault(_S.BadResourceUnavailable)
        wanted = struct_from_binary(ua.ReadParameters, buffer).NodesToRead
        if nature.most and len(wanted) > nature.most:
            return _fault(_S.BadTooManyOperations)
        read = ua.ReadResponse()
        read.Results = [server.value(one.NodeId) for one in wanted]
        return read

    def _respond(
        self, request_id: int, request: bytes, response: object, kind: bytes = b"MSG", security: bytes = b""
    ) -> None:
        buffer = Buffer(request)
        nodeid_from_binary(buffer)
        handle = int(struct_from_binary(ua.RequestHeader, buffer).RequestHandle)
        header = response.ResponseHeader  # type: ignore[attr-defined]
        header.RequestHandle = ua.UInt32({"right": handle, "zero": 0, "next": handle + 1}[self._is.handle])
        body = struct_to_binary(response)
        parts = [(b"F", body)]
        if self._is.chunks and kind == b"MSG" and len(body) > 1:
            at = self._draw.randrange(1, len(body))
            parts = [(b"C", body[:at]), (b"F", body[at:])]
        for mark, part in parts:
            self._sequence += 1
            head = security or struct.pack("<I", self._token)
            rest = head + struct.pack("<II", self._sequence, request_id) + part
            self._send(kind + mark + struct.pack("<II", 12 + len(rest), 1) + rest)
        self._answers += 1
        if self._is.closes_after and self._answers >= self._is.closes_after:
            self._loop.call_at(max(self._loop.time(), self._sent_s) + _SOON_S, self._line.hang_up)

    def _send(self, data: bytes) -> None:
        now_s, nature = self._loop.time(), self._is
        if nature.pieces_s:
            at, begins_s = self._draw.randrange(1, len(data)), max(now_s, self._sent_s + _APART_S)
            self._sent_s = begins_s + nature.pieces_s
            self._line.send(data[:at], begins_s)
            self._line.send(data[at:], self._sent_s)
        else:
            self._line.send(data, now_s)


def _fault(code: int) -> ua.ServiceFault:
    fault = ua.ServiceFault()
    fault.ResponseHeader.ServiceResult = ua.StatusCode(ua.UInt32(code))
    return fault


def _endpoint() -> ua.EndpointDescription:
    endpoint = ua.EndpointDescription()
    endpoint.EndpointUrl = ua.String("opc.tcp://host:4840")
    endpoint.SecurityMode = ua.MessageSecurityMode.None_
    endpoint.SecurityPolicyUri = ua.String("http://opcfoundation.org/UA/SecurityPolicy#None")
    anonymous = ua.UserTokenPolicy()
    anonymous.PolicyId, anonymous.TokenType = ua.String("anonymous"), ua.UserTokenType.Anonymous
    endpoint.UserIdentityTokens = [anonymous]
    return endpoint
