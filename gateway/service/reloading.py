"""The configuration of a running gateway, read again: on SIGHUP, or because a command says so."""

import asyncio
import logging
from contextlib import suppress
from pathlib import Path

from drivers.base import DriverError
from gateway.acquisition.reload import PreparedReload, ReloadError
from gateway.config.file import load
from gateway.config.problems import ConfigError
from gateway.model.codes import NoticeCode
from gateway.model.text import Text, text_of
from gateway.runtime.workers.process import Bounds, WorkError, in_process_within
from gateway.service.service import Service

log = logging.getLogger(__name__)

JUDGED_WITHIN = Bounds(elapsed_s=30.0, processor_s=10.0, more_bytes=300 * 2**20)
"""A file of 500 channels takes a second of a small computer's processor; the rest is for one that is busy."""


class Reloading:
    """Applies one configuration after the other to a service. One that cannot be applied changes nothing.

    Parameters
    ----------
    path: the configuration's file
    within: what judging it may take
    """

    def __init__(self, path: Path, within: Bounds = JUDGED_WITHIN) -> None:
        self._path, self._within = path, within
        self._next: PreparedReload | None = None
        """None: the file is read when it is its turn."""
        self._asked = asyncio.Event()
        self._checking = self._applying = False
        self._signals = 0

    def hang_up(self) -> None:
        """Read the file again and apply it; what is wrong with it goes to the log."""
        self._signals += 1
        self._asked.set()

    async def ask(self, service: Service) -> Text:
        """A gateway.service.command_taker.AskReload: check the file, and begin to apply it."""
        if self._asked.is_set() or self._checking or self._applying:
            raise ReloadError(Text(NoticeCode.RELOAD_UNDER_WAY))
        signals, self._checking = self._signals, True
        try:
            prepared = await self._prepared(service)
        except (ConfigError, DriverError) as error:
            raise ReloadError(_text_of(error)) from error
        except ReloadError:
            raise
        except Exception as error:
            log.exception("not reloaded; the previous configuration stays in use")
            raise ReloadError(Text(NoticeCode.RELOAD_UNEXPECTED, kind=type(error).__name__)) from error
        finally:
            self._checking = False
        if self._signals != signals:  # the file may have been another one by then
            raise ReloadError(Text(NoticeCode.RELOAD_CAME_BETWEEN))
        self._next = prepared
        self._asked.set()
        file, fingerprint = self._path.name, prepared.new.fingerprint()[:16]
        exchanged = sorted({*prepared.change.stopped, *prepared.change.started})
        if not exchanged:
            return Text(NoticeCode.RELOAD_SAME, file=file, fingerprint=fingerprint)
        return Text(NoticeCode.RELOAD_APPLIED, file=file, fingerprint=fingerprint, buses=exchanged)

    async def run(self, service: Service) -> None:
        """Reload whenever it is asked for, until cancelled."""
        while True:
            await self._asked.wait()
            self._asked.clear()
            commanded, self._next, self._applying = self._next, None, True
            try:
                change = await service.reload(commanded or await self._prepared(service))
            except (ConfigError, DriverError, ReloadError) as error:
                log.error("%s", Text(NoticeCode.OLD_CONFIGURATION_STAYS, why=_text_of(error)))
                self._tell(service, commanded, _text_of(error))
            except Exception as error:
                log.exception("not reloaded; the previous configuration stays in use")
                self._tell(service, commanded, Text(NoticeCode.RELOAD_UNEXPECTED, kind=type(error).__name__))
            else:
                log.warning(
                    "%s",
                    Text(
                        NoticeCode.RELOADED,
                        file=str(self._path),
                        fingerprint=service.fingerprint,
                        buses=change.started or "none",
                    ),
                )
            self._applying = False

    async def _prepared(self, service: Service) -> PreparedReload:
        """Raises ConfigError, SetupError, ReloadError.

        The file and those that it names are first judged elsewhere: a thread that takes too long cannot be ended.
        """
        try:
            await in_process_within(self._within, judge, self._path)
        except WorkError as error:
            raise ReloadError(Text(NoticeCode.RELOAD_NOT_JUDGED, file=self._path.name, why=text_of(error))) from error
        return await service.prepare(await asyncio.to_thread(load, self._path))

    def _tell(self, service: Service, commanded: PreparedReload | None, why: Text) -> None:
        """Who gave the command was told that it is being applied."""
        if commanded is not None:
            service.tell(Text(NoticeCode.NOT_RELOADED, why=why))


def judge(path: Path) -> None:
    """Take what reading the file takes; what is wrong with it shows when the gateway reads it."""
    with suppress(ConfigError):
        load(path)


def _text_of(error: ConfigError | DriverError | ReloadError) -> Text:
    return error.text if isinstance(error, ConfigError) else text_of(error)
