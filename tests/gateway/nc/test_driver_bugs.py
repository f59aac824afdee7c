"""Whatever a control's driver raises or returns, the link reports it, reconnects and causes no step."""

import asyncio
import logging
import math
import struct
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from talc.frame import Why
from tests.benches.nc_link_bench import LinkBench, answer_wrongly, decision

BUGS = [ValueError("bad value"), IndexError("list index"), struct.error("unpack"), AssertionError(), KeyError("X")]
IN_A_PERIOD = ["snapshot", "heartbeat", "read_compensation", "write_compensation"]
AT_ITS_BEGIN = ["connect", "claim"]


def spoil(bench: LinkBench, operation: str, error: BaseException) -> Callable[[], None]:
    """Make the operation raise from now on; call what is returned to repair it."""

    async def raises(*_: object) -> None:
        raise error

    setattr(bench.control, operation, raises)
    return lambda: delattr(bench.control, operation)


def tracebacks(caplog: pytest.LogCaptureFixture) -> list[str]:
    """Messages of the records with a traceback."""
    return [r.getMessage() for r in caplog.records if r.levelno >= logging.WARNING and r.exc_info]


@pytest.mark.parametrize("error", BUGS, ids=lambda error: type(error).__name__)
@pytest.mark.parametrize("operation", IN_A_PERIOD)
async def test_what_a_driver_raises_loses_the_connection_and_it_comes_back_without_a_step(
    operation: str, error: Exception, caplog: pytest.LogCaptureFixture
) -> None:
    bench = LinkBench("compensate")
    async with bench.following(6.0, until_s=3.0):
        repair = spoil(bench, operation, error)
        await bench.clock.run_until(40.0)
        assert bench.link.present is None
        beats = len(bench.control.beats)
        await bench.clock.run_until(41.0)
        assert bench.link.armed
        assert len(bench.control.beats) - beats <= 2, "a lost control is not beaten each period"
        repair()
        bench.link.follow(decision(6.0))
        await bench.clock.run_until(90.0)
        assert bench.control.in_force == (0.0, 0.0, 6.0)
    heights = [offsets[2] for _, offsets in bench.control.writes]
    assert np.abs(np.diff([0.0, *heights])).max() <= 1.0 + 1e-9
    assert len(tracebacks(caplog)) == 1
    named = [text for text in bench.notices if f"unexpected {type(error).__name__} in {operation}" in text]
    assert len(named) == 1
    assert bench.notices[-1] == "NC: connected again"


async def test_exceptions_of_two_kinds_are_reported_as_two_problems() -> None:
    bench = LinkBench("monitor")
    async with bench.running():
        for error in (ValueError("bad value"), ValueError("another value"), IndexError("list index")):
            spoil(bench, "snapshot", error)
            await bench.clock.run_until(bench.clock.monotonic() + 60.0)
    named = [text for text in bench.notices if "unexpected" in text]
    assert [("bad value" in text, "list index" in text) for text in named] == [(True, False), (False, True)]


@pytest.mark.parametrize("operation", AT_ITS_BEGIN)
async def test_what_a_driver_raises_when_it_connects_is_tried_again(operation: str) -> None:
    bench = LinkBench("compensate")
    repair = spoil(bench, operation, struct.error("unpack requires 4 bytes"))
    async with bench.following(2.0, until_s=10.0):
        repair()
        await bench.clock.run_until(50.0)
        assert bench.control.in_force == (0.0, 0.0, 2.0)


async def test_a_request_that_its_library_cancels_does_not_end_the_link_silently() -> None:
    bench = LinkBench("monitor")
    repair = spoil(bench, "snapshot", asyncio.CancelledError())
    async with bench.running():
        await bench.clock.run_until(5.0)
        assert any("the library cancelled its own request" in text for text in bench.notices)
        repair()
        await bench.clock.run_until(40.0)
        assert bench.link.present is not None


async def test_a_computer_without_memory_is_no_fault_of_the_control() -> None:
    bench = LinkBench("monitor")
    spoil(bench, "snapshot", MemoryError())
    task = asyncio.create_task(bench.link.run())
    await bench.clock.run_until(2.0)
    with pytest.raises(MemoryError):
        await task


WRONG: dict[str, tuple[str, Callable[[Any], object]]] = {
    "no snapshot": ("snapshot", lambda _: None),
    "no axis": ("snapshot", lambda s: replace(s, positions={"X": 0.0})),
    "axis is no number": ("snapshot", lambda s: replace(s, positions=s.positions | {"Z": math.nan})),
    "axis is a text": ("snapshot", lambda s: replace(s, positions=s.positions | {"Z": "1"})),
    "axis is longer than any float": ("snapshot", lambda s: replace(s, positions=s.positions | {"Z": 10**400})),
    "states are none": ("snapshot", lambda s: replace(s, states=None)),
    "two offsets": ("read_compensation", lambda o: o[:2]),
    "no offsets": ("read_compensation", lambda _: None),
    "offsets are longer than any float": ("read_compensation", lambda _: (10**400, 0, 0)),
    "offsets are texts": ("read_compensation", lambda _: ("x", "y", "z")),
}


@pytest.mark.parametrize("name", WRONG)
async def test_an_answer_that_the_interface_excludes_is_the_control_s_fault(name: str) -> None:
    bench = LinkBench("compensate")
    async with bench.following(4.0, until_s=2.0):
        repair = answer_wrongly(bench, *WRONG[name])
        await bench.clock.run_until(20.0)
        assert bench.link.present is None
        assert [text for text in bench.notices if f"in {WRONG[name][0]}" in text]
        repair()
        bench.link.follow(decision(4.0))
        await bench.clock.run_until(80.0)
        assert bench.control.in_force == (0.0, 0.0, 4.0)


@pytest.mark.parametrize("operation", ["request_probing", "probing_status"])
async def test_what_a_driver_raises_while_it_probes_is_a_measurement_refused(operation: str) -> None:
    bench = LinkBench("compensate")
    async with bench.running():
        await bench.clock.run_until(2.0)
        repair = spoil(bench, operation, IndexError("list index out of range"))
        outcome = await bench.measured(10.0)
        assert outcome.measurement is None
        assert "unexpected IndexError" in outcome.reason
        repair()
        await bench.clock.run_until(30.0)
        assert bench.link.present is not None


CENTRES: list[Any] = [((1.0, 2.0),), ((1.0, 2.0, 3.0), (1.0,)), "six", ((1e300, 0.0, 0.0),) * 6, 7.0, (None,) * 6]


@pytest.mark.parametrize("centres", CENTRES)
async def test_a_result_of_any_form_makes_no_measurement_and_ends_nothing(centres: Any) -> None:
    bench = LinkBench("monitor")
    wrong = {"probing_status": lambda s: replace(s, state="done", centres_mm=centres)}
    async with bench.running():
        await bench.clock.run_until(2.0)
        answer_wrongly(bench, "probing_status", wrong["probing_status"])
        cycle = asyncio.create_task(bench.link.measure(Why.INTERVAL))
        await bench.clock.run_until(10.0)
        assert (await cycle).measurement is None


@pytest.mark.parametrize("operation", ["heartbeat", "read_compensation", "write_compensation", "release", "close"])
async def test_what_a_driver_raises_while_it_stops_keeps_nothing_else_from_being_done(operation: str) -> None:
    bench = LinkBench("compensate")
    async with bench.running():
        bench.link.follow(decision(2.0))
        await bench.clock.run_until(10.0)
    spoil(bench, operation, ValueError("bad value"))
    await bench.stopped(40.0)
    if operation != "close":
        assert bench.control.closed == 1
    if operation != "release":
        assert bench.control.owner == 0
