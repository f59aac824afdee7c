"""The common part of `run` and `demo`: store, telemetry and service of one configuration, until a signal."""

import asyncio
import logging
import math
import threading
from collections.abc import Awaitable, Callable, Sequence
from contextlib import AsyncExitStack

from gateway.acquisition.wire_log import WireLogWriter
from gateway.config.applied import ConfigurationApplied
from gateway.config.model import GatewayConfig
from gateway.config.packed import packed_toml
from gateway.control.restart.earlier import EarlierRun, earlier_run
from gateway.control.restart.rebuild import Interrupted, Rebuilt
from gateway.control.restart.snapshots import SnapshotKeeper
from gateway.model.codes import NoticeCode
from gateway.model.events import EventReported, Events, Sink
from gateway.model.text import Text
from gateway.model.wording import event_of
from gateway.nc.settings import Identity
from gateway.runtime.clocks import ServiceClock
from gateway.runtime.extras import lack_of
from gateway.runtime.time_service import clock_synchronised
from gateway.runtime.versions import program_version, versions
from gateway.service.day_reports import DayReports
from gateway.service.service import Service, not_published
from gateway.service.stored_answers import course_of, history_of, rows_of
from gateway.storage.answers import DiskWork
from gateway.storage.readings import Retention
from gateway.storage.store import Store, boot_id
from gateway.telemetry.publisher import TelemetryPublisher
from gateway.telemetry.reached import Reached
from talc.frame import EventKind

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
    reload: Callable[[Service], Awaitable[Text]] | None = None,
) -> None:
    """Run the service of a configuration until `stop`; everything is stored before it is published.

    more: sinks besides the gateway's own
    started: called with the service before it runs
    wire_log: records everything that passes on the wires
    reload: reads the configuration again because a command says so

    Raises DriverError, StoreError, or an exception group of them.
    """
    boot = boot_id()
    async with AsyncExitStack() as stack:
        with clock.hold():  # the disk takes real time
            store = await DiskWork(
                config.storage.path, lambda: _store(config, boot, clock), unwanted=Store.leave
            ).until(stop)
        if store is None:
            log.warning("%s", Text(NoticeCode.STOPPED_EARLY, path=str(config.storage.path)))
            return
        stack.enter_context(store)
        past = await _past(store, config, clock, stop)
        if past is None:
            return
        news = _news(past, config)
        if store.migrated_from is not None:
            news.insert(0, Text(NoticeCode.STORE_MIGRATED, aside=store.migrated_from.name))
        prior = None if config.prior is None else (config.prior.content_hash, config.prior.text)
        store.begin(config.canonical(), config.fingerprint(), versions(*_WIRES), prior)
        events = Events(store.record)
        reached = Reached(config.telemetry, config.machine.name, boot) if config.telemetry.enabled else None
        synchronised = (lambda: None) if simulated else clock_synchronised

        async def on_disk() -> None:
            with clock.hold():  # the disk takes real time
                await store.on_disk()

        service = Service(
            config,
            clock,
            events.publish,
            past,
            None if wire_log is None else wire_log.tap,
            lambda: store.health,
            Identity.of(boot, store.predecessor),
            synchronised,
            on_disk,
            reload,
            not_published if reached is None else reached.connection,
        )
        publisher: TelemetryPublisher | None = None
        if reached is not None:
            reports = DayReports(config.storage.path, clock.utc, missing=lack_of("report"))
            publisher = TelemetryPublisher(
                config.telemetry,
                config.machine.name,
                config.input_names,
                clock,
                boot,
                simulated=simulated,
                reached=reached,
                history=history_of(config.storage.path),
                course=course_of(config.storage.path, config.grid.step_s),
                stored=rows_of(config.storage.path),
                report=reports,
                periods_missed=service.periods_missed,
                answers_s=service.answers_s,
                clock_known=service.clock_known,
                obey=service.obey,
                scenario=service.scenario,
            )
            events.subscribe_to_all((await stack.enter_async_context(publisher)).publish)
            stack.callback(reports.close)  # before the telemetry, which waits for its last answer
        if config.metrics.listen is not None:
            from gateway.service.metrics import GatewayFigures, MetricsServer  # loaded only where it is wanted

            figures = GatewayFigures(
                config.machine.name,
                program_version(),
                clock.utc,
                service.periods_missed,
                dict if publisher is None else publisher.dropped_by_kind,
            )
            stack.enter_context(MetricsServer(config.metrics, config.telemetry.tls, figures))
            events.subscribe_to_all(figures.take)
        events.subscribe_to_all(SnapshotKeeper(past, store, config).take)
        if wire_log is not None:
            events.subscribe(ConfigurationApplied, _reconfiguring(wire_log, packed_toml(config)))
        events.subscribe_to_all(*more)
        for text in news:
            log.warning("%s", text)
            events.publish(EventReported(event_of(EventKind.OPERATOR, text), past.last_k))
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


def _news(past: EarlierRun, config: GatewayConfig) -> list[Text]:
    """What has changed since the latest run, and what became of what was learnt."""
    news, method = [], config.talc.method
    if past.elsewhere:
        news.append(Text(NoticeCode.REFERENCE_ELSEWHERE))
    if past.former_method is not None:
        news.append(Text(NoticeCode.METHOD_CONTINUES, method=method, former=past.former_method))
    if past.other_prior and config.prior is None:
        news.append(Text(NoticeCode.PRIOR_GONE))
    elif past.other_prior:
        news.append(Text(NoticeCode.PRIOR_DIFFERS, path=str(config.talc.prior)))
    if past.changes:
        code = NoticeCode.SETTINGS_LEARNT_AGAIN if method == "learner" else NoticeCode.SETTINGS_MODELS_KEPT
        news.append(Text(code, changes="; ".join(past.changes)))
    return news


async def _past(store: Store, config: GatewayConfig, clock: ServiceClock, stop: asyncio.Event) -> EarlierRun | None:
    """What an earlier run left; None: stopped before it was rebuilt, which can take minutes after an update."""
    ended = threading.Event()

    def progress(_: Rebuilt) -> None:
        if ended.is_set():
            raise Interrupted

    def rebuilt() -> EarlierRun | None:
        try:
            return earlier_run(store, config, progress)
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


def _reconfiguring(wire_log: WireLogWriter, recorded: str) -> Callable[[ConfigurationApplied], None]:
    """Starts another wire log when the buses or devices differ from those recorded."""

    def take(applied: ConfigurationApplied) -> None:
        nonlocal recorded
        if (wires := packed_toml(applied.config)) != recorded:
            recorded = wires
            wire_log.reconfigure(wires)

    return take
