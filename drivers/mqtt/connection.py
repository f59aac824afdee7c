"""One connection to an MQTT broker (3.1.1) by the library paho, with its errors raised as ours.

A thread of the library receives and acknowledges. Every method here blocks, at most for the time that it is given.
Nothing reconnects by itself: whoever opened the connection decides. Importing this loads paho.
"""

import socket
import ssl
import threading
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Final

from paho.mqtt.client import Client, ConnectFlags, DisconnectFlags, MQTTMessage, topic_matches_sub
from paho.mqtt.enums import CallbackAPIVersion, MQTTErrorCode, MQTTProtocolVersion
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from drivers.base import BadAnswer, ConnectError, NoAnswer, Refused
from drivers.bounded_file import check_bounds
from drivers.credential_files import secret_in, trust_in, unusable_file
from drivers.mqtt.settings import MqttServer
from drivers.text import Text

_QOS: Final = 1
"""At least once: the broker acknowledges."""
_GOODBYE_S: Final = 1.0


@dataclass(frozen=True, slots=True)
class Publication:
    """What is handed to a broker."""

    topic: str
    payload: bytes
    retained: bool
    """Whether the broker keeps it for subscribers that come later."""


def is_subscribed(wanted: str, topic: str) -> bool:
    """Whether a subscription to `wanted`, which may have wildcards, has this topic."""
    return topic_matches_sub(wanted, topic)


class _ReportingClient(Client):
    """A client that says when its thread has ended by an error: nothing would be received any more.

    failed: called then, in that thread
    """

    failed: Callable[[str], None]

    def _thread_main(self) -> None:
        try:
            super()._thread_main()
        except Exception as error:  # noqa: BLE001 - whatever the library raises at what a broker sent
            self.failed(Text("mqtt_malformed", error=repr(error)))


class MqttConnection:
    """A connection that is opened once.

    Parameters
    ----------
    server: where the broker is
    timeout_s: how long connecting, and one acknowledgement, may take
    will: what the broker publishes when this client is lost without a goodbye
    on_message: receives topic, payload and whether it was retained, from the library's thread
    on_lost: called once when the connection is lost, from any thread

    Raises SetupError for files that cannot be used.
    """

    def __init__(
        self,
        server: MqttServer,
        timeout_s: float,
        *,
        will: Publication | None = None,
        on_message: Callable[[str, bytes, bool], None] | None = None,
        on_lost: Callable[[], None] = lambda: None,
    ) -> None:
        self._server, self._timeout_s, self._on_lost, self._on_message = server, timeout_s, on_lost, on_message
        self._news = threading.Condition()
        self._answer: ReasonCode | None = None
        self._lost = ""
        """Why the connection is gone; empty while it is there."""
        self._acknowledged = 0
        self._granted: dict[int, Sequence[ReasonCode]] = {}
        client = _ReportingClient(
            CallbackAPIVersion.VERSION2,
            server.client_id or "",
            clean_session=True,
            protocol=MQTTProtocolVersion.MQTTv311,
            reconnect_on_failure=False,
        )
        client.connect_timeout = timeout_s
        if server.user is not None:
            file = server.password_file
            client.username_pw_set(server.user, None if file is None else secret_in("password_file", file))
        if server.encrypted:
            client.tls_set_context(_tls(server))
        if will is not None:
            client.will_set(will.topic, will.payload, _QOS, will.retained)
        client.failed = self._end
        client.on_connect, client.on_disconnect = self._connected, self._disconnected
        client.on_publish, client.on_subscribe = self._published, self._subscribed
        client.on_message = self._received
        self._client = client

    @property
    def is_open(self) -> bool:
        """Whether the broker has accepted the connection and it has not been lost."""
        with self._news:
            return self._answer is not None and not self._answer.is_failure and not self._lost

    @property
    def lost(self) -> str:
        """Why the connection was lost; empty if it was not."""
        with self._news:
            return self._lost

    def open(self) -> None:
        """Connect. Raises ConnectError, NoAnswer, Refused; nothing is open then."""
        server = self._server
        try:
            self._client.connect(server.host, server.port, server.keepalive_s)
        except ssl.SSLCertVerificationError as error:
            hint = Text("mqtt_authority")
            what = Text("mqtt_certificate", url=server.url, why=error.verify_message)
            raise Refused(what, hint=hint) from error
        except ssl.SSLError as error:
            what = Text("mqtt_no_tls", url=server.url, why=error.reason or str(error))
            raise Refused(what, hint=Text("mqtt_tls_port")) from error
        except TimeoutError as error:
            raise NoAnswer(Text("mqtt_silent", url=server.url, timeout_s=self._timeout_s)) from error
        except OSError as error:
            hint = Text("mqtt_running")
            raise ConnectError(
                Text("mqtt_not_open", url=server.url, why=error.strerror or str(error)), hint=hint
            ) from error
        self._client.loop_start()
        try:
            hint = Text("mqtt_not_taken_tls" if server.encrypted else "mqtt_not_taken")
            self._wait(lambda: self._answer is not None, Text("mqtt_request"), hint)
            if self._answer is not None and self._answer.is_failure:
                who = Text("user", user=repr(server.user)) if server.user else Text("mqtt_no_user")
                hint = Text("mqtt_check_user")
                raise Refused(Text("mqtt_refuses_user", url=server.url, who=who, answer=str(self._answer)), hint=hint)
        except BaseException:
            self.drop()
            raise

    def publish(self, publications: Sequence[Publication]) -> None:
        """Hand these over and wait until the broker has acknowledged all. Raises ConnectError, NoAnswer."""
        with self._news:
            until = self._acknowledged + len(publications)
        for one in publications:
            code = self._client.publish(one.topic, one.payload, _QOS, one.retained).rc
            if code != MQTTErrorCode.MQTT_ERR_SUCCESS:
                raise ConnectError(Text("mqtt_failed", url=self._server.url, why=self.lost or code.name))
        self._wait(lambda: self._acknowledged >= until, Text("mqtt_messages", count=len(publications)))

    def subscribe(self, topics: Sequence[str]) -> Collection[str]:
        """Receive these topics from now on; returns those that the broker refuses to send.

        Raises BadAnswer, ConnectError, NoAnswer.
        """
        code, number = self._client.subscribe([(topic, _QOS) for topic in topics])
        if code != MQTTErrorCode.MQTT_ERR_SUCCESS or number is None:
            raise ConnectError(Text("mqtt_failed", url=self._server.url, why=self.lost or code.name))
        self._wait(lambda: number in self._granted, Text("mqtt_subscription"))
        granted = self._granted.pop(number)
        if len(granted) != len(topics):
            what = Text("mqtt_topics", url=self._server.url, count=len(granted), wanted=len(topics))
            raise BadAnswer(what, hint=Text("mqtt_is_broker"))
        return {topic for topic, one in zip(topics, granted, strict=True) if one.is_failure}

    def close(self) -> None:
        """Say goodbye, so that the broker does not publish the will."""
        self._client.disconnect()
        with self._news:
            self._news.wait_for(lambda: bool(self._lost), _GOODBYE_S)
        self.drop()

    def drop(self) -> None:
        """Close without a goodbye."""
        with self._news:
            self._lost = self._lost or "closed"
        connected = self._client.socket()
        if isinstance(connected, socket.socket):
            with suppress(OSError):  # ends the library's thread, which otherwise waits for a broker that is silent
                connected.shutdown(socket.SHUT_RDWR)
        self._client.loop_stop()
        # Else the sockets that wake its thread stay open until it is collected; the library has no other way.
        self._client._reset_sockets()  # noqa: SLF001

    def _wait(self, done: Callable[[], bool], what: str, hint: str = "") -> None:
        with self._news:
            if not self._news.wait_for(lambda: done() or bool(self._lost), self._timeout_s):
                raise NoAnswer(Text("mqtt_unacknowledged", url=self._server.url, what=what, timeout_s=self._timeout_s))
            if not done():
                raise ConnectError(Text("mqtt_failed", url=self._server.url, why=self._lost), hint=hint)

    def _connected(
        self, _client: Client, _data: object, _flags: ConnectFlags, reason: ReasonCode, _more: Properties | None
    ) -> None:
        with self._news:
            self._answer = reason
            self._news.notify_all()

    def _disconnected(
        self, _client: Client, _data: object, _flags: DisconnectFlags, reason: ReasonCode, _more: Properties | None
    ) -> None:
        self._end(Text("mqtt_lost", reason=str(reason)))

    def _end(self, why: str) -> None:
        with self._news:
            first, self._lost = not self._lost, self._lost or why
            self._news.notify_all()
        if first:
            self._on_lost()

    def _published(
        self, _client: Client, _data: object, _number: int, _reason: ReasonCode, _more: Properties | None
    ) -> None:
        with self._news:
            self._acknowledged += 1
            self._news.notify_all()

    def _subscribed(
        self, _client: Client, _data: object, number: int, reasons: Sequence[ReasonCode], _more: Properties | None
    ) -> None:
        with self._news:
            self._granted[number] = reasons
            self._news.notify_all()

    def _received(self, _client: Client, _data: object, message: MQTTMessage) -> None:
        try:
            topic = message.topic
        except UnicodeDecodeError:  # of a name that nobody can ask for; it would end the library's thread
            return
        if self._on_message is not None:
            self._on_message(topic, bytes(message.payload), message.retain)


def _tls(server: MqttServer) -> ssl.SSLContext:
    class Handshaking(ssl.SSLSocket):
        """The library leaves the socket open when the handshake fails."""

        def do_handshake(self, block: bool = False) -> None:
            try:
                super().do_handshake(block)
            except BaseException:
                self.close()
                raise

    context = trust_in(server.authority)
    context.sslsocket_class = Handshaking
    if server.certificate is not None and server.key is not None:
        try:
            check_bounds(server.certificate, server.key)
            context.load_cert_chain(server.certificate, server.key, password=lambda: "")
        except (OSError, ValueError) as error:
            raise unusable_file("certificate", server.certificate, error) from error
    return context
