"""The configuration of a running gateway, read again: on SIGHUP, or because a command says so."""

import asyncio
import logging
from pathlib import Path

from drivers.base import DriverError
from gateway.acquisition import ReloadError, lines_of
from gateway.clock import RealClock
from gateway.config import ConfigError, GatewayConfig, OtherBus, load
from gateway.service import Service

log = logging.getLogger(__name__)

_LONGEST_TEXT = 2000


class Reloading:
    """Applies one configuration after the other to a service. One that cannot be applied changes nothing.

    Parameters
    ----------
    path: the configuration's file
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._next: GatewayConfig | None = None
        """Checked already; None: the file is read when it is its turn."""
        self._asked = asyncio.Event()
        self._applying = False

    def hang_up(self) -> None:
        """Read the file again and apply it; what is wrong with it goes to the log."""
        self._asked.set()

    async def ask(self, service: Service) -> str:
        """A gateway.control.AskReload: check the file, and begin to apply it."""
        if self._asked.is_set() or self._applying:
            raise ReloadError("another reload is under way; give the command again")
        try:
            config = await asyncio.to_thread(_read, self._path)
            change = service.changes(config)
        except (ConfigError, DriverError) as error:
            raise ReloadError(str(error)[:_LONGEST_TEXT]) from error
        self._next = config
        self._asked.set()
        fingerprint = f"{self._path.name}, fingerprint {config.fingerprint()[:16]}"
        exchanged = sorted({*change.stopped, *change.started})
        if not exchanged:
            return f"{fingerprint} is in use; no bus has changed"
        return f"{fingerprint} is being applied; its buses {', '.join(exchanged)} are exchanged, the others go on"

    async def run(self, service: Service) -> None:
        """Reload whenever it is asked for, until cancelled."""
        while True:
            await self._asked.wait()
            self._asked.clear()
            config, self._next, self._applying = self._next, None, True
            try:
                read = await asyncio.to_thread(_read, self._path) if config is None else config
                change = await service.reload(read)
            except (ConfigError, DriverError, ReloadError) as error:
                log.error("not reloaded; the previous configuration stays in use: %s", error)
                self._tell(service, config, str(error))
            except Exception as error:
                log.exception("not reloaded; the previous configuration stays in use")
                self._tell(service, config, f"unexpected {type(error).__name__}")
            else:
                exchanged = ", ".join(change.started) or "none"
                log.warning(
                    "reloaded %s, fingerprint %s, buses exchanged: %s", self._path, service.fingerprint, exchanged
                )
            self._applying = False

    def _tell(self, service: Service, commanded: GatewayConfig | None, why: str) -> None:
        """Who gave the command was told that it is being applied."""
        if commanded is not None:
            service.tell(f"not reloaded; the previous configuration stays in use: {why[:_LONGEST_TEXT]}")


def _read(path: Path) -> GatewayConfig:
    """The configuration, with its drivers built once: that imports the library of a bus that is the first of its kind,
    which takes longer than a period and so may not happen in the event loop. Raises ConfigError, SetupError."""
    config = load(path)  # builds the drivers of other packages, for whoever runs them
    lines_of(config, RealClock(), only=[bus.name for bus in config.buses if not isinstance(bus, OtherBus)])
    return config
