"""Asks a third-party device as the service does: again, when its answer is later than usual."""

import asyncio
from collections import Counter
from collections.abc import Awaitable, Callable, Generator, Iterable, Sequence
from contextlib import suppress
from typing import TypeVar

import pytest

from drivers.base import Driver, NoAnswer, Reading

LIMIT_S = 60.0
MOST_REPEATS = 20
"""The most repeats of one question. The waits grow to a timeout of some seconds, so about as many fit into LIMIT_S."""

Answer = TypeVar("Answer")

_PROPERTY = "asked again"
_counted = Counter[str]()
"""Repeats so far in this process."""


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, object, object]:
    """Put a test's repeats into its report, also into one that a worker sends."""
    before = _counted["repeats"]
    try:
        return (yield)
    finally:
        if repeats := _counted["repeats"] - before:
            item.user_properties.append((_PROPERTY, repeats))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Write how often devices were asked again, if at all."""
    if line := told(report for reports in terminalreporter.stats.values() for report in reports):
        terminalreporter.write_line(line)


def told(reports: Iterable[object]) -> str:
    """A line for the summary of the tests; empty if no device was asked again."""
    tests = {
        report.nodeid: int(str(value))
        for report in reports
        if isinstance(report, pytest.TestReport) and report.when == "call"
        for name, value in report.user_properties
        if name == _PROPERTY
    }
    if not tests:
        return ""
    worst = max(tests, key=lambda test: tests[test])
    return f"asked again: {sum(tests.values())} times in {len(tests)} tests, {tests[worst]} times in {worst}"


async def answered(ask: Callable[[bool], Awaitable[Answer]]) -> Answer:
    """The answer to a question; the question gets whether it repeats one that was not answered.

    On a serial line the driver learns from the first answer to wait no longer than 50 ms, and leaves it to the poller
    to ask again; a late answer is as good. On a busy computer another program is late now and then. The summary of the
    tests reports how often.

    Raises NoAnswer after MOST_REPEATS, TimeoutError after LIMIT_S.
    """
    async with asyncio.timeout(LIMIT_S):
        for repeats in range(MOST_REPEATS):
            with suppress(NoAnswer):
                return await ask(repeats > 0)
            _counted["repeats"] += 1
        return await ask(True)


async def readings_of(driver: Driver) -> Sequence[Reading]:
    """A reading of each channel; asks until the device answers. Raises as `answered` does."""
    return await answered(lambda again: driver.read(again=again))
