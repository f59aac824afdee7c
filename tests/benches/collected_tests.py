"""Tries the mutants of a module with tests that are collected once, each in a fork with those that reach it.

A fork exchanges the code of the function that differs, runs the tests that execute the statement, first those that
kill most in the least time, and ends at the first that fails. What differs outside of functions cannot be tried here.
"""

import gc
import json
import math
import os
import resource
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import pytest

from tests.benches.mutated_functions import Mutant, exchanges, loaded_functions, statement_lines

LEAST_CPU_S, LEAST_WAIT_S, TIMES = 5.0, 40.0, 10
"""A test of a mutant may take ten times as long as without it, and at least these times, s."""
_FAILED, _BROKEN = 1, 99


@dataclass(slots=True)
class _Reaching:
    """A test, the module's lines that it executes, and what it costs."""

    item: pytest.Item
    lines: frozenset[int]
    cpu_s: float
    wait_s: float
    kills: int = 0
    runs: int = 0

    @property
    def worth(self) -> float:
        """Expected kills per second."""
        return (self.kills + 1) / (self.runs + 2) / (self.cpu_s + 0.02)


@dataclass(slots=True)
class _Ended:
    """A fork that has ended: what it reported, None if a signal ended it because it took too long; its exit code and
    time."""

    told: dict[str, Any] | None
    code: int
    cpu_s: float
    wait_s: float


@dataclass(slots=True)
class CollectedTests:
    """A plugin of pytest. It takes the place of the run of the tests.

    Parameters
    ----------
    file, source: the module
    mutants: those to be tried
    end_s: when to stop, by time.monotonic
    tried: called with a mutant, the test that killed it (empty: none) and whether it did not end
    """

    file: Path
    source: str
    mutants: Sequence[Mutant]
    end_s: float
    tried: Callable[[Mutant, str, bool], None]
    _tell: int | None = None
    """Where a fork reports to."""
    _ran: list[str] = field(default_factory=list)

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        if session.testsfailed:
            raise session.Failed("the tests could not be collected")
        functions, reaching = loaded_functions(self.file), self._reaching(session.items)
        for mutant in self.mutants:
            if time.monotonic() >= self.end_s:
                break
            differing = exchanges(self.source, mutant.source, self.file)
            if not differing or any((name, line) not in functions for name, line, _ in differing):
                continue
            lines = statement_lines(self.source, mutant.line)
            tests = sorted((t for t in reaching if t.lines.intersection(lines)), key=lambda t: -t.worth)

            def put(differing: list[tuple[str, int, CodeType]] = differing) -> None:
                for name, line, code in differing:
                    functions[name, line].__code__ = code

            self._try(mutant, tests, put)
        return True

    def _try(self, mutant: Mutant, tests: Sequence[_Reaching], put: Callable[[], None]) -> None:
        if not tests:
            self.tried(mutant, "", False)
            return
        ended = self._forked(lambda: self._run(put, tests))
        if ended.code == _BROKEN:
            raise RuntimeError(f"line {mutant.line}: a mutant could not be tried")
        by = "" if ended.told is None else str(ended.told["failed"])
        ran = tests if not by else tests[: [t.item.nodeid for t in tests].index(by) + 1]
        if ended.told is not None:
            for test in ran:
                test.runs += 1
                test.kills += test.item.nodeid == by
        self.tried(mutant, by, ended.told is None)

    def _reaching(self, items: Iterable[pytest.Item]) -> list[_Reaching]:
        """Each test that passes, run once."""
        found = []
        for item in items:

            def run(item: pytest.Item = item) -> dict[str, Any]:
                lines = self._traced()
                return self._run(lambda: None, [_Reaching(item, frozenset(), 60.0, 60.0)]) | {"lines": sorted(lines)}

            ended = self._forked(run)
            if ended.told is None or ended.told["failed"]:
                print(f"{item.nodeid} does not pass by itself: left out", file=sys.stderr)
            else:
                lines = frozenset(ended.told["lines"])
                found.append(_Reaching(item, lines, ended.cpu_s, ended.wait_s))
        cpu_s = sum(t.cpu_s for t in found)
        print(f"{self.file.name}: {len(found)} tests, {cpu_s:.1f} s of processor time", file=sys.stderr, flush=True)
        return found

    def _traced(self) -> set[int]:
        """The module's lines that are executed from now on."""
        lines, name = set[int](), str(self.file)

        def line(frame: FrameType, _: str, __: object) -> Callable[..., Any]:
            lines.add(frame.f_lineno)
            return line

        def call(frame: FrameType, _: str, __: object) -> Callable[..., Any] | None:
            return line if frame.f_code.co_filename == name else None

        threading.settrace(call)
        sys.settrace(call)
        return lines

    def _run(self, put: Callable[[], None], tests: Sequence[_Reaching]) -> dict[str, Any]:
        put()
        for test, following in zip(tests, [*tests[1:], None], strict=True):
            item = test.item
            self._ran.append(item.nodeid)
            most_s = math.ceil(time.process_time() + max(LEAST_CPU_S, TIMES * test.cpu_s))
            resource.setrlimit(resource.RLIMIT_CPU, (most_s, resource.RLIM_INFINITY))
            signal.setitimer(signal.ITIMER_REAL, max(LEAST_WAIT_S, TIMES * test.wait_s))
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=None if following is None else following.item)
        return {"failed": ""}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed and self._tell is not None:
            self._end({"failed": report.nodeid})  # without what else the test would wait for

    def _end(self, told: dict[str, Any]) -> None:
        assert self._tell is not None
        os.write(self._tell, json.dumps(told).encode())
        os._exit(_FAILED if told["failed"] else 0)

    def _forked(self, work: Callable[[], dict[str, Any]]) -> _Ended:
        """`work` in a fork, and in whatever it starts."""
        before, began_s = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
        out, self._tell = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(out)
            self._work(work)
        os.close(self._tell)
        self._tell = None
        status, told = waited(child, math.inf), b""
        assert status is not None
        os.set_blocking(out, False)  # something that the tests started may still have the other end
        with suppress(BlockingIOError):
            told = os.read(out, 1 << 16)
        os.close(out)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        took_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        code = os.waitstatus_to_exitcode(status)
        return _Ended(json.loads(told) if told else None, code, took_s, time.monotonic() - began_s)

    def _work(self, work: Callable[[], dict[str, Any]]) -> None:
        """In the child; does not return."""
        told: dict[str, Any] | None
        try:
            os.setsid()
            gc.enable()
            told = work()
        except BaseException:  # noqa: BLE001 - a mutant may raise anything, also to end the process
            told = {"failed": self._ran[-1]} if self._ran else None
        if told is None:
            os._exit(_BROKEN)
        self._end(told)


def waited(child: int, limit_s: float) -> int | None:
    """The exit status; None: ended after this time. Ends what it started, too."""
    end_s, pause_s, status = time.monotonic() + limit_s, 0.002, None
    while time.monotonic() < end_s:
        found, now = os.waitpid(child, os.WNOHANG)
        if found:
            status = now
            break
        time.sleep(pause_s)
        pause_s = min(0.1, 1.5 * pause_s)
    with suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    if status is None:
        os.waitpid(child, 0)
    return status
