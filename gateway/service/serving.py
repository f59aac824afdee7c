"""The common part of `run` and `demo`: store, telemetry and service of one configuration, until a signal."""

import asyncio
import logging
import math
import threading
from collections.abc import Callable, Sequence
from contextlib import AsyncExitStack
from importlib.metadata import version

from gateway.acquisition.wire_log import WireLogWriter
from gateway.config.applied import ConfigurationApplied
from gateway.config.model import GatewayConfig
from gateway.config.packed import packed_toml
from gateway.control.restart.earlier import Past, past_in
from gateway.control.restart.rebuild import Interrupted, Rebuilt
from gateway.control.restart.snapshots import SnapshotKeeper
from gateway.model.events import EventReported, GatewayEvent, Sink, in_order
from gateway.nc.settings import Identity
from gateway.runtime.clocks import ServiceClock
from gateway.runtime.extras import missing_of
from gateway.runtime.time_service import clock_synchronised
from gateway.runtime.versions import versions
from gateway.service.day_reports import DayReports
from gateway.service.service import Service
from gateway.service.stored_answers import course_of, history_of, rows_of
from gateway.storage.answers import DiskWork
from gateway.storage.readings import Retention
from gateway.storage.store import Store, boot_id
from gateway.telemetry.publisher import TelemetryPublisher
from talc.frame import Event, EventKind

log = logging.getLogger(__name__)

_SILENT_S = 5.0
"""A stopped gateway waits no longer for a disk that does not answer."""
_WIRES = ("pymodbus", "canopen", "asyncua", "eclipse-zenoh")


async def serve(
    config: GatewayConfig,
    clock: ServiceClock,
    stop: asyncio.Event,
    *,
    simulated: bool,
    more: Sequence[Sink] = (),
    started: Callable[[Service], None] = lambda _: None,
    wire_log: WireLogWriter | None = None,
) -> None:
    """Run the service of a configuration until `stop`; everything is stored before it is published.

    wire_log: records everything that passes on the wires

    Raises DriverError, StoreError, TelemetryError, or an exception group of them.
    """
    boot = boot_id()
    async with AsyncExitStack() as stack:
        with clock.hold():  # the disk takes real time
            store = await DiskWork(
                config.storage.path, lambda: _store(config, boot, clock), unwanted=Store.leave
            ).until(stop)
        if store is None:
            log.warning("%s: stopped before it was open", config.storage.path)
            return
        stack.enter_context(store)
        past = await _past(store, config, clock, stop)
        if past is None:
            return
        news = _news(past, config)
        if store.migrated_from is not None:
            news.insert(0, f"storage: the database was migrated; the old one is kept as {store.migrated_from.name}")
        prior = None if config.prior is None else (config.prior.content_hash, config.prior.text)
        store.begin(config.canonical(), config.fingerprint(), versions(*_WIRES), prior)
        sinks: list[Sink] = [store.record]
        telemetry: TelemetryPublisher | None = None
        if config.telemetry.enabled:
            reports = DayReports(config.storage.path, clock.utc, missing=missing_of("report"))
            telemetry = TelemetryPublisher(
                config.telemetry,
                config.machine.name,
                config.input_names,
                clock,
                boot,
                simulated=simulated,
                history=history_of(config.storage.path),
                course=course_of(config.storage.path, config.grid.step_s),
                stored=rows_of(config.storage.path),
                report=reports,
            )
            sinks.append((await stack.enter_async_context(telemetry)).publish)
            stack.callback(reports.close)  # before the telemetry, which waits for its last answer
        if config.metrics.listen is not None:
            from gateway.service.metrics import GatewayFigures, MetricsServer  # loaded only where it is wanted

            figures = GatewayFigures(config.machine.name, version("talc-gateway"))
            stack.enter_context(MetricsServer(config.metrics, config.telemetry.tls, figures))
            sinks.append(figures.take)
        sinks.append(SnapshotKeeper(past, store, config).take)
        if wire_log is not None:
            sinks.append(_reconfiguring(wire_log, packed_toml(config)))
        identity = Identity.of(boot, store.predecessor)
        tap = None if wire_log is None else wire_log.tap
        sink = in_order([*sinks, *more])
        for text in news:
            log.warning("%s", text)
            sink(EventReported(Event(EventKind.OPERATOR, text), past.last_k))
        synchronised = (lambda: None) if simulated else clock_synchronised

        async def on_disk() -> None:
            with clock.hold():  # the disk takes real time
                await store.on_disk()

        service = Service(config, clock, sink, past, tap, lambda: store.health, identity, synchronised, on_disk)
        if telemetry is not None:
            telemetry.count_missed(lambda: service.periods_missed)
            telemetry.ask_clock(lambda: service.clock_known)
            telemetry.take_commands(service.obey)
        started(service)
        await service.run(stop)


def _store(config: GatewayConfig, boot: str, clock: ServiceClock) -> Store:
    return Store(
        config.storage.path,
        boot,
        clock,
        commit_s=config.storage.commit_s,
        retention=Retention(
            samples_days=config.storage.keep_samples_days,
            minutes_days=config.storage.keep_minutes_days,
            most_mb=config.storage.most_mb,
        ),
        silent_s=_SILENT_S,
        origin=clock.origin(),
    )


def _news(past: Past, config: GatewayConfig) -> list[str]:
    """What has changed since the latest run, and what became of what was learnt."""
    news, method = [], config.talc.method
    if past.former_method is not None:
        news.append(
            f"[talc] method: {method} continues the record that {past.former_method} made, with all that it learns from"
            f" the record; to stay with the former method, write method = '{past.former_method}' under [talc] and"
            " restart"
        )
    if past.other_prior:
        now = "none is set now" if config.prior is None else f"{config.talc.prior} differs from the former one"
        news.append(f"[talc] prior: {now}; the learner starts again with it and learns from the whole record")
    if past.changes:
        kept = (
            "it learnt from the whole record again" if method == "learner" else "models of inputs still here are kept"
        )
        news.append(f"inputs or [talc] settings differ from the latest run's ({'; '.join(past.changes)}): {kept}")
    return news


async def _past(store: Store, config: GatewayConfig, clock: ServiceClock, stop: asyncio.Event) -> Past | None:
    """What an earlier run left; None: stopped before it was rebuilt, which can take minutes after an update."""
    ended = threading.Event()

    def progress(_: Rebuilt) -> None:
        if ended.is_set():
            raise Interrupted

    def rebuilt() -> Past | None:
        try:
            return past_in(store, config, progress)
        except Interrupted:
            return None

    rebuilding = DiskWork(config.storage.path, rebuilt, limit_s=math.inf)  # years of record take minutes
    with clock.hold():
        stopping = asyncio.create_task(_passed_on(stop, ended))
        try:
            return await rebuilding.until(stop)
        finally:
            ended.set()
            stopping.cancel()


async def _passed_on(stop: asyncio.Event, ended: threading.Event) -> None:
    await stop.wait()
    ended.set()


def _reconfiguring(wire_log: WireLogWriter, recorded: str) -> Sink:
    """A sink that starts another wire log when the buses or devices differ from those recorded."""

    def take(event: GatewayEvent) -> None:
        nonlocal recorded
        if isinstance(event, ConfigurationApplied) and (wires := packed_toml(event.config)) != recorded:
            recorded = wires
            wire_log.reconfigure(wires)

    return take
