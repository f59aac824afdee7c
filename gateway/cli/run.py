"""`talc-gateway run`."""

import asyncio
import logging
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

from drivers.base import DriverError
from gateway.acquisition import ReloadError
from gateway.cli.running import serve
from gateway.cli.signals import stop_on_signals
from gateway.clock import RealClock
from gateway.config import ConfigError, GatewayConfig, load, packed_toml
from gateway.recordings import WireLogWriter
from gateway.service import Service

log = logging.getLogger(__name__)


def run_service(config: GatewayConfig, path: Path, record: Path | None = None, record_mb: float = 100.0) -> None:
    """Run the gateway until SIGINT or SIGTERM. SIGHUP reads `path` again and applies what changed, or nothing.

    record: the traffic on the wires goes to this file, up to `record_mb`, and as much to the one before it
    """

    async def main() -> None:
        stop, hang_up = asyncio.Event(), asyncio.Event()
        stop_on_signals(stop)
        asyncio.get_running_loop().add_signal_handler(signal.SIGHUP, hang_up.set)
        reloading: list[asyncio.Task[None]] = []

        def started(service: Service) -> None:
            reloading.append(asyncio.create_task(_reload(service, path, hang_up), name="reload"))

        try:
            with _wire_log(config, record, record_mb) as wire_log:
                await serve(config, RealClock(), stop, simulated=False, started=started, wire_log=wire_log)
        finally:
            for task in reloading:
                task.cancel()
            await asyncio.gather(*reloading, return_exceptions=True)

    asyncio.run(main())


@contextmanager
def _wire_log(config: GatewayConfig, path: Path | None, most_mb: float) -> Iterator[WireLogWriter | None]:
    if path is None:
        yield None
        return
    if path.exists():
        path.replace(path.with_name(path.name + ".1"))
    with WireLogWriter(
        path, packed_toml(config), datetime.now(UTC), most_bytes=round(most_mb * 1e6), rotate=True
    ) as writer:
        yield writer
    if writer.dropped:
        log.warning("%s: %d lines are missing: the disk was too slow", path, writer.dropped)


async def _reload(service: Service, path: Path, asked: asyncio.Event) -> None:
    """Reload on request, until cancelled. A configuration that cannot be applied changes nothing."""
    while True:
        await asked.wait()
        asked.clear()
        try:
            change = await service.reload(load(path))
        except (ConfigError, DriverError, ReloadError) as error:
            log.error("not reloaded, the previous configuration stays in use: %s", error)
        except Exception:
            log.exception("not reloaded, the previous configuration stays in use")
        else:
            exchanged = ", ".join(change.started) or "none"
            log.warning("reloaded %s, fingerprint %s, buses exchanged: %s", path, service.fingerprint, exchanged)
