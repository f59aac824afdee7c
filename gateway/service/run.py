"""`talc-gateway run`: runs the service of one configuration until it is stopped."""

import asyncio
import logging
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

from gateway.acquisition.wire_log import WireLogWriter, not_recorded
from gateway.config.applied import ConfigurationApplied
from gateway.config.model import GatewayConfig
from gateway.config.packed import packed_toml
from gateway.model.codes import NoticeCode
from gateway.model.text import Text, text_of
from gateway.runtime.clocks import RealClock
from gateway.runtime.garbage import freeze_gc
from gateway.runtime.signals import stop_on_signals
from gateway.runtime.workers.control_group import UndividedError, divide
from gateway.service.alive import WatchedClock, feed
from gateway.service.memory import give_back_large_blocks, raise_descriptors
from gateway.service.opening import opening
from gateway.service.reloading import Reloading
from gateway.service.service import Service
from gateway.service.service_manager import ServiceManager
from gateway.service.serving import serve

log = logging.getLogger(__name__)

_SIGNS_PER_LIMIT = 3
"""How often within the service manager's limit it gets a sign of life."""
_STOP_MARGIN_S = 60.0
"""For what ends besides the ramp: a read, a training, the last rows and messages."""


def run_service(config: GatewayConfig, path: Path, record: Path | None = None, record_mb: float = 100.0) -> None:
    """Run the gateway until SIGINT or SIGTERM. SIGHUP reads `path` again and applies what changed, or nothing.

    record: the traffic on the wires goes to this file, up to `record_mb`, and as much to the one before it
    """
    if logging.getLogger().level > logging.INFO:
        logging.getLogger("gateway").setLevel(logging.INFO)  # a service says what it does
    give_back_large_blocks()
    raise_descriptors()
    _divide()
    manager = ServiceManager()

    async def main() -> None:
        stop, reloading = asyncio.Event(), Reloading(path)
        stop_on_signals(stop)
        asyncio.get_running_loop().add_signal_handler(signal.SIGHUP, reloading.hang_up)
        clock = WatchedClock(RealClock())
        beside: list[asyncio.Task[None]] = []
        running = config

        def started(service: Service) -> None:
            def applied(event: ConfigurationApplied) -> None:
                nonlocal running
                running = event.config
                clock.expect(service.parts.works_s)
                for line in opening(running):
                    log.info("%s", line)
                manager.ready(f"machine {running.machine.name}")

            service.events.subscribe(ConfigurationApplied, applied)
            freeze_gc()
            beside.append(asyncio.create_task(reloading.run(service), name="reload"))
            beside.append(asyncio.create_task(_tell_end(manager, stop, lambda: running), name="end"))
            if manager.watchdog_s is not None:
                feeding = feed(manager, manager.watchdog_s / _SIGNS_PER_LIMIT, clock, stop)
                beside.append(asyncio.create_task(feeding, name="watchdog"))

        began_s = clock.monotonic()
        try:
            with _wire_log(config, record, record_mb) as wire_log:
                await serve(
                    config, clock, stop, simulated=False, started=started, wire_log=wire_log, reload=reloading.ask
                )
        finally:
            for task in beside:
                task.cancel()
            await asyncio.gather(*beside, return_exceptions=True)
        log.info("%s", Text(NoticeCode.ENDED_AFTER, s=clock.monotonic() - began_s))

    asyncio.run(main())


def _divide() -> None:
    try:
        if divide():
            log.info("%s", Text(NoticeCode.LEARNING_APART))
    except UndividedError as error:
        log.info("%s", Text(NoticeCode.LEARNING_BESIDE, why=text_of(error)))


async def _tell_end(manager: ServiceManager, stop: asyncio.Event, running: Callable[[], GatewayConfig]) -> None:
    """Once `stop` is set, ask for the time that taking the offsets back may need."""
    await stop.wait()
    longest_s = stop_s(running())
    log.info("%s", Text(NoticeCode.STOPPING, most_s=longest_s))
    manager.stopping("stopping", longest_s)


def stop_s(config: GatewayConfig) -> float:
    """How long a stop may take, s."""
    return _STOP_MARGIN_S + ramp_s(config)


def ramp_s(config: GatewayConfig) -> float:
    """How long taking the largest offsets back to zero takes, s; a disarmed gateway does so with `hold` too."""
    compensation = config.compensation
    if config.nc is None or compensation.mode != "compensate":
        return 0.0
    return max(compensation.bound_um) / compensation.slew_um_per_s


@contextmanager
def _wire_log(config: GatewayConfig, path: Path | None, most_mb: float) -> Iterator[WireLogWriter | None]:
    if path is None:
        yield None
        return
    for text in not_recorded(config):
        log.warning("%s", text)
    if path.exists():
        path.replace(path.with_name(path.name + ".1"))
    with WireLogWriter(
        path, packed_toml(config), datetime.now(UTC), most_bytes=round(most_mb * 1e6), rotate=True
    ) as writer:
        yield writer
    if writer.dropped:
        log.warning("%s", Text(NoticeCode.LINES_LOST, path=str(path), n=writer.dropped))
