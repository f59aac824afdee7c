"""Metrics for Prometheus: the latest events are kept, and the figures are computed from them on request."""

import asyncio
import math
import ssl
import threading
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from enum import StrEnum
from typing import Any, Self

from prometheus_client import CollectorRegistry, make_asgi_app
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric, StateSetMetricFamily
from prometheus_client.registry import Collector

from drivers.base import Quality, Reading
from drivers.bounded_file import check_bounds
from gateway.config.applied import ConfigurationApplied
from gateway.config.certificates import certificate_ends
from gateway.config.consequences import unarmed
from gateway.config.metrics import Metrics
from gateway.config.telemetry import TelemetryTls
from gateway.model.events import (
    CompensationStepped,
    DecisionMade,
    EventReported,
    GatewayEvent,
    Health,
    HealthChecked,
    MeasurementEnded,
    ReadingsTaken,
    StorageChanged,
    StoreHealth,
)
from gateway.runtime.listening import ACCEPTED_AT_ONCE, GuardedSocket
from talc.frame import Decision, FloatArray
from talc.names import THERMAL_ERRORS

_MOST_CONNECTIONS = 16
_LONGEST_REQUEST = 8192
"""Bytes."""
_BETWEEN_S = 0.05
"""Between two answers."""
_SHOWN = 16
"""Digits of the configuration's fingerprint, as in the log."""


class MetricsError(OSError):
    """The figures cannot be served; the message says where and why."""


class GatewayFigures(Collector):
    """The metrics of a gateway. `take` is a gateway.model.events.Sink; `collect` may be called from any thread.

    Parameters
    ----------
    machine: its name, a label of every figure
    version: of the program
    now: the computer's clock, UTC
    periods_missed: by bus, how many there were since the start
    dropped: by kind, how many messages were not published since the start
    """

    def __init__(
        self,
        machine: str,
        version: str,
        now: Callable[[], datetime] = lambda: datetime.now(UTC),
        periods_missed: Callable[[], Mapping[str, int]] = dict,
        dropped: Callable[[], Mapping[str, int]] = dict,
    ) -> None:
        self._machine, self._version = machine, version
        self._now, self._periods_missed, self._dropped = now, periods_missed, dropped
        self._fingerprint, self._unarmed = "", 0
        self._certificates: Mapping[str, datetime] = {}
        self._lock = threading.Lock()
        self._readings: dict[str, Reading] = {}
        self._decision: Decision | None = None
        self._health: Health | None = None
        self._store: StoreHealth | None = None
        self._offsets_um: Mapping[str, float] = {}
        self._counts = Counter[str]()
        self._measurements = Counter(used=0, rejected=0)
        self._events = Counter[str]()

    def take(self, event: GatewayEvent) -> None:
        """Keep what the figures are made of."""
        with self._lock:
            self._take(event)

    def _take(self, event: GatewayEvent) -> None:
        match event:
            case ConfigurationApplied(config):
                self._fingerprint, self._unarmed = config.fingerprint(), len(unarmed(config))
                self._certificates = certificate_ends(config)
                known = {channel.name for channel in config.channels}
                self._readings = {name: r for name, r in self._readings.items() if name in known}
            case ReadingsTaken(readings):
                self._readings.update((reading.channel, reading) for reading in readings)
                self._counts["readings"] += len(readings)
            case DecisionMade(decision):
                self._decision = decision
                self._counts["decisions"] += 1
            case HealthChecked(health):
                self._health, self._store = health, health.store
            case StorageChanged(store):
                self._store = store
            case CompensationStepped(write):
                self._offsets_um = dict(zip("XYZ", write.step.offsets_um, strict=True))
            case MeasurementEnded(outcome):
                self._measurements["rejected" if outcome.measurement is None else "used"] += 1
            case EventReported(reported):
                self._events[reported.kind.value] += 1
            case _:
                pass

    def collect(self) -> Iterator[Metric]:
        """The figures now."""
        for family in self._families():
            family.samples = [one._replace(labels={"machine": self._machine, **one.labels}) for one in family.samples]
            yield family

    def _families(self) -> Iterator[Metric]:
        with self._lock:
            yield from self._of_program()
            yield from self._of_health()
            yield from self._of_readings()
            yield from self._of_decision()
            yield _labelled("talc_offset_um", "Offset of the compensation, µm", "axis", self._offsets_um)
            yield _counted("talc_measurements", "Probing cycles that ended", "result", self._measurements)
            yield _counted("talc_events", "Events in words, by kind", "kind", self._events)
            yield CounterMetricFamily("talc_readings", "Readings taken", value=self._counts["readings"])
            yield CounterMetricFamily("talc_decisions", "Decisions made", value=self._counts["decisions"])

    def _of_program(self) -> Iterator[Metric]:
        build = GaugeMetricFamily(
            "talc_build", "Always 1; the labels say what runs", labels=("version", "configuration")
        )
        build.add_metric((self._version, self._fingerprint[:_SHOWN]), 1.0)
        yield build
        yield GaugeMetricFamily("talc_time_seconds", "The computer's clock, Unix time", self._now().timestamp())
        yield GaugeMetricFamily("talc_unarmed", "Things that the configuration leaves off", self._unarmed)
        ends = {field: end.timestamp() for field, end in self._certificates.items()}
        yield _labelled("talc_certificate_ends_seconds", "When a certificate ends, Unix time", "field", ends)
        yield _counted("talc_periods_missed", "Periods without a read", "bus", self._periods_missed())
        yield _counted("talc_messages_dropped", "Messages that were not published", "kind", self._dropped())

    def _of_health(self) -> Iterator[Metric]:
        health, store = self._health, self._store
        if health is not None:
            yield GaugeMetricFamily("talc_uptime_seconds", "Since the service began to run", health.uptime_s)
            yield GaugeMetricFamily("talc_channels", "Channels of the configuration", health.channels)
            yield GaugeMetricFamily("talc_channels_good", "Channels with a good value", health.channels_good)
            yield GaugeMetricFamily("talc_waits_for", "Things that the gateway waits for", len(health.waits_for))
            yield _state("talc_nc", "The control", health.nc)
            paused, disarmed = float(health.paused is not None), float(health.disarmed is not None)
            yield GaugeMetricFamily("talc_paused", "1: a person has paused the compensation", paused)
            yield GaugeMetricFamily("talc_disarmed", "1: a person has disarmed the gateway", disarmed)
            if health.clock_synchronised is not None:
                known = float(health.clock_synchronised)
                yield GaugeMetricFamily("talc_clock_synchronised", "1: a time server keeps the clock", known)
        if health is not None and (telemetry := health.telemetry) is not None:
            connected = float(not telemetry.problem)
            yield GaugeMetricFamily("talc_telemetry_connected", "0: nobody is reached, or it is not open", connected)
            if telemetry.confirmed is not None:
                back = float(telemetry.confirmed)
                yield GaugeMetricFamily("talc_telemetry_confirmed", "1: what it sends comes back from the router", back)
            two = float(bool(telemetry.other))
            yield GaugeMetricFamily("talc_two_of_one_name", "1: another gateway has the same name", two)
            since = telemetry.since.timestamp()
            yield GaugeMetricFamily("talc_telemetry_since_seconds", "When that began, Unix time", since)
        if store is not None:
            failing = float(bool(store.problem))
            yield GaugeMetricFamily("talc_store_failing", "1: nothing can be stored now", failing)
            yield GaugeMetricFamily("talc_store_waiting_rows", "Rows that wait in memory", store.waiting)
            yield CounterMetricFamily(
                "talc_store_dropped_rows", "Rows that were dropped because too many waited", store.dropped
            )
            if store.free_mb is not None:
                yield GaugeMetricFamily("talc_store_free_bytes", "Free space on the store's disk", store.free_mb * 1e6)

    def _of_readings(self) -> Iterator[Metric]:
        value = GaugeMetricFamily(
            "talc_reading", "Latest good value, in the channel's unit", labels=("channel", "unit")
        )
        good = GaugeMetricFamily("talc_reading_good", "1: the latest reading is good", labels=("channel",))
        for name, reading in self._readings.items():
            good.add_metric((name,), float(reading.quality is Quality.GOOD))
            if reading.quality is Quality.GOOD:
                value.add_metric((name, reading.unit), reading.value)
        yield value
        yield good

    def _of_decision(self) -> Iterator[Metric]:
        decision = self._decision
        if decision is None:
            return
        yield _state("talc_phase", "Phase of the control", decision.phase)
        yield GaugeMetricFamily("talc_decision_grid_index", "Grid index of the latest decision", decision.k)
        unit = "µm, and µm/m for EA0C, EB0C and EC0C"
        yield _labelled("talc_error_predicted", f"Predicted error, {unit}", "error", _by_error(decision.predicted))
        yield _labelled("talc_error_corrected", f"Corrected error, {unit}", "error", _by_error(decision.corrected))
        yield _labelled("talc_error_sigma", f"Standard uncertainty, {unit}", "error", _by_error(decision.sigma))
        limits = _by_error(decision.limits)
        yield _labelled("talc_error_limit", f"Limit of the 95 % interval, {unit}", "error", limits)


class MetricsServer:
    """Serves figures at /metrics while it is entered, in a thread with its own event loop; one answer a connection.

    Parameters
    ----------
    settings: the [metrics] section, with `listen`
    tls: the [telemetry.tls] section
    figures: what is served

    Raises MetricsError on entry.
    """

    def __init__(self, settings: Metrics, tls: TelemetryTls, figures: GatewayFigures) -> None:
        self._settings, self._tls = settings, tls
        registry = CollectorRegistry()
        registry.register(figures)
        self._app = make_asgi_app(registry)
        self._turn = asyncio.Lock()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._listening: GuardedSocket | None = None
        self._server: asyncio.Server | None = None
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Self:
        place = self._settings.place
        if place is None:
            raise MetricsError("[metrics] listen: missing")
        try:
            tls = _server_side(self._tls) if self._settings.tls else None
            listening = self._listening = GuardedSocket(place.host, place.port, strangers=_MOST_CONNECTIONS)
        except OSError as error:
            raise MetricsError(f"[metrics] listen = '{self._settings.listen}': {error.strerror or error}") from error
        loop = self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=loop.run_forever, name="metrics", daemon=True)
        self._thread.start()
        serving = asyncio.start_server(
            self._answer, sock=listening, ssl=tls, limit=_LONGEST_REQUEST, backlog=ACCEPTED_AT_ONCE
        )
        self._server = asyncio.run_coroutine_threadsafe(serving, loop).result()
        return self

    def __exit__(self, *_: object) -> None:
        if self._loop is None or self._thread is None:
            return
        asyncio.run_coroutine_threadsafe(self._stop(), self._loop).result()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    async def _stop(self) -> None:
        if self._listening is not None and self._server is not None:
            self._server.close()
            await self._listening.end()
        await asyncio.gather(*asyncio.all_tasks() - {asyncio.current_task()}, return_exceptions=True)

    async def _answer(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(OSError, asyncio.IncompleteReadError, asyncio.LimitOverrunError, ValueError):
            line, *lines = (await reader.readuntil(b"\r\n\r\n")).decode("latin-1").split("\r\n")
            method, target, _ = line.split()
            path, _, query = target.partition("?")
            if method != "GET" or path not in ("/metrics", "/"):
                writer.write(b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\nConnection: close\r\n\r\n")
            else:
                async with self._turn:  # however many ask, the gateway has its processor
                    writer.write(await self._page(query, lines))
                    await asyncio.sleep(_BETWEEN_S)
            await writer.drain()
        writer.close()

    async def _page(self, query: str, lines: Iterable[str]) -> bytes:
        """What the library answers to these headers."""
        headers = [(name.encode(), value.strip().encode()) for name, _, value in (one.partition(":") for one in lines)]
        sent: list[Any] = []

        async def receive() -> Mapping[str, str]:
            return {"type": "http.request"}

        async def send(message: object) -> None:
            sent.append(message)

        await self._app({"type": "http", "query_string": query.encode(), "headers": headers}, receive, send)
        start, body = sent
        stated = [*start["headers"], (b"Content-Length", str(len(body["body"])).encode()), (b"Connection", b"close")]
        head = b"".join(b"%s: %s\r\n" % one for one in stated)
        return b"HTTP/1.1 %d OK\r\n%s\r\n%s" % (start["status"], head, body["body"])


def _server_side(tls: TelemetryTls) -> ssl.SSLContext:
    check_bounds(tls.authority if tls.mutual else None, tls.certificate, tls.key)
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH, cafile=str(tls.authority) if tls.mutual else None)
    if tls.mutual:
        context.verify_mode = ssl.CERT_REQUIRED
    if tls.certificate is not None:
        context.load_cert_chain(tls.certificate, tls.key, password=str)  # never asks
    return context


def _state(name: str, text: str, now: StrEnum) -> Metric:
    """Every member of its type, 1 at this one."""
    return StateSetMetricFamily(name, text, {state.value: state is now for state in type(now)})


def _labelled(name: str, text: str, label: str, values: Mapping[str, float]) -> Metric:
    family = GaugeMetricFamily(name, text, labels=(label,))
    for key, value in values.items():
        if math.isfinite(value):
            family.add_metric((key,), value)
    return family


def _counted(name: str, text: str, label: str, counts: Mapping[str, int]) -> Metric:
    family = CounterMetricFamily(name, text, labels=(label,))
    for key, count in counts.items():
        family.add_metric((key,), count)
    return family


def _by_error(values: FloatArray) -> dict[str, float]:
    return dict(zip(THERMAL_ERRORS, values.tolist(), strict=True))
