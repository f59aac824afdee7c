"""The log on standard error: with the time for people; with the priority and without the time for journald."""

import logging
import os
import sys
from copy import copy
from typing import Final, TextIO

from gateway.model.text import Language, Text, language_wanted
from gateway.runtime.terminal import printable

_PRIORITIES: Final = ((logging.CRITICAL, 2), (logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6))
"""Level, and its priority in sd-daemon(3); what is below the last one is 7, debug."""


class _Printable(logging.Formatter):
    """In a language, without control characters: what devices and controls say must not reach a terminal as escape
    sequences."""

    def __init__(self, form: str, language: Language) -> None:
        super().__init__(form)
        self._language = language

    def format(self, record: logging.LogRecord) -> str:
        if isinstance(record.args, tuple) and any(isinstance(value, Text) for value in record.args):
            record = copy(record)  # other handlers have their own language
            record.args = tuple(self._language.of(v) if isinstance(v, Text) else v for v in record.args or ())
        return "\n".join(printable(line) for line in super().format(record).split("\n"))


class _Journal(_Printable):
    """Each line begins with its priority, `<4>`; also a traceback's lines, which would otherwise have the default
    one."""

    def format(self, record: logging.LogRecord) -> str:
        level = next((number for least, number in _PRIORITIES if record.levelno >= least), 7)
        return "\n".join(f"<{level}>{line}" for line in super().format(record).split("\n"))


def log_to_stderr(level: int) -> None:
    """Log everything from `level` on, in the language of the environment."""
    language = Language(language_wanted(os.environ))
    formatter: logging.Formatter = _Printable("%(asctime)s %(levelname)s %(name)s: %(message)s", language)
    if _is_journal(sys.stderr):
        formatter = _Journal("%(name)s: %(message)s", language)
    handler = logging.StreamHandler()
    handler.setFormatter(formatter)
    logging.basicConfig(level=level, handlers=[handler])


def _is_journal(stream: TextIO) -> bool:
    """Whether systemd connected this stream to the journal: it names the device and inode in the environment."""
    try:
        status = os.fstat(stream.fileno())
    except (OSError, ValueError):  # closed, or not a file
        return False
    return os.environ.get("JOURNAL_STREAM") == f"{status.st_dev}:{status.st_ino}"
