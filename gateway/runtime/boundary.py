"""The boundary to drivers and their libraries: beyond it there are only driver errors and requested cancellations."""

import asyncio
import logging
from collections.abc import Awaitable
from typing import TypeVar

from drivers.base import DriverError
from gateway.model.codes import NoticeCode
from gateway.model.text import Text, text_of

log = logging.getLogger(__name__)

T = TypeVar("T")


class UnexpectedError(DriverError):
    """A driver or its library raised an undeclared exception, or answered what its interface excludes.

    `__cause__` is the original exception.
    """


def unexpected(error: Exception, operation: str, *, device: str = "") -> UnexpectedError:
    """The error that stands for `error`, which is to be its cause."""
    text = Text(NoticeCode.UNEXPECTED_IN, kind=type(error).__name__, operation=operation, error=text_of(error))
    return UnexpectedError(text, device=device, hint=Text(NoticeCode.PLEASE_REPORT))


async def contained(work: Awaitable[T], operation: str) -> T:
    """Await a driver or its library once. Raises DriverError; the traceback of an unexpected exception is logged."""
    try:
        return await uncancelled(work)
    except (DriverError, MemoryError):
        raise
    except Exception as error:
        log.exception("unexpected %s in %s", type(error).__name__, operation)
        raise unexpected(error, operation) from error


async def uncancelled(work: Awaitable[T]) -> T:
    """Await a driver. Raises RuntimeError for a cancellation that nobody requested, and for an exit of the program.

    A library that closes its connection cancels the futures of its own requests. Passed on, that would silently end the
    calling task as if it had been cancelled.
    """
    try:
        return await work
    except asyncio.CancelledError as error:
        task = asyncio.current_task()
        if task is None or task.cancelling():
            raise
        raise RuntimeError("the library cancelled its own request") from error
    except SystemExit as error:
        raise RuntimeError("the library wanted to end the program") from error
