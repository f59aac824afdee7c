"""Metrics for Prometheus: the latest events are kept, and the figures are computed from them on request."""

import math
import threading
from collections import Counter
from collections.abc import Iterator, Mapping
from enum import StrEnum
from typing import Self
from wsgiref.simple_server import WSGIServer

from prometheus_client import CollectorRegistry, start_http_server
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric, StateSetMetricFamily
from prometheus_client.registry import Collector

from drivers.base import Quality, Reading
from gateway.config.applied import ConfigurationApplied
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
from talc.frame import Decision, FloatArray
from talc.names import THERMAL_ERRORS


class MetricsError(OSError):
    """The figures cannot be served; the message says where and why."""


class GatewayFigures(Collector):
    """The metrics of a gateway. `take` is a gateway.model.events.Sink; `collect` may be called from any thread.

    Parameters
    ----------
    machine: its name
    version: of the program
    """

    def __init__(self, machine: str, version: str) -> None:
        self._machine, self._version = machine, version
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
        with self._lock:
            yield from self._of_health()
            yield from self._of_readings()
            yield from self._of_decision()
            yield _labelled("talc_offset_um", "Offset of the compensation, µm", "axis", self._offsets_um)
            yield _counted("talc_measurements", "Probing cycles that ended", "result", self._measurements)
            yield _counted("talc_events", "Events in words, by kind", "kind", self._events)
            yield CounterMetricFamily("talc_readings", "Readings taken", value=self._counts["readings"])
            yield CounterMetricFamily("talc_decisions", "Decisions made", value=self._counts["decisions"])

    def _of_health(self) -> Iterator[Metric]:
        build = GaugeMetricFamily("talc_build", "Always 1; the labels say what runs", labels=("machine", "version"))
        build.add_metric((self._machine, self._version), 1.0)
        yield build
        health, store = self._health, self._store
        if health is not None:
            yield GaugeMetricFamily("talc_uptime_seconds", "Since the service began to run", health.uptime_s)
            yield GaugeMetricFamily("talc_channels", "Channels of the configuration", health.channels)
            yield GaugeMetricFamily("talc_channels_good", "Channels with a good value", health.channels_good)
            yield GaugeMetricFamily("talc_waits_for", "Things that the gateway waits for", len(health.waits_for))
            yield _state("talc_nc", "The control", health.nc)
            if health.clock_synchronised is not None:
                known = float(health.clock_synchronised)
                yield GaugeMetricFamily("talc_clock_synchronised", "1: a time server keeps the clock", known)
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


class MetricsServer:
    """Serves figures at /metrics while it is entered.

    Parameters
    ----------
    settings: the [metrics] section, with `listen`
    tls: the [telemetry.tls] section
    figures: what is served

    Raises MetricsError on entry.
    """

    def __init__(self, settings: Metrics, tls: TelemetryTls, figures: GatewayFigures) -> None:
        self._settings, self._tls = settings, tls
        self._registry = CollectorRegistry()
        self._registry.register(figures)
        self._server: WSGIServer | None = None
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Self:
        place, tls = self._settings.place, self._tls if self._settings.tls else TelemetryTls()
        if place is None:
            raise MetricsError("[metrics] listen: missing")
        try:
            self._server, self._thread = start_http_server(
                place.port,
                place.host,
                self._registry,
                certfile=None if tls.certificate is None else str(tls.certificate),
                keyfile=None if tls.key is None else str(tls.key),
                client_cafile=str(tls.authority) if tls.mutual else None,
                client_auth_required=tls.mutual,
            )
        except OSError as error:
            raise MetricsError(f"[metrics] listen = '{self._settings.listen}': {error.strerror or error}") from error
        return self

    def __exit__(self, *_: object) -> None:
        if self._server is not None and self._thread is not None:
            self._server.shutdown()
            self._server.server_close()
            self._thread.join()


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
