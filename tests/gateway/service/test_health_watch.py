"""The health that a gateway reports every 10 s, with what it waits for."""

import ctypes
import math
import struct

import pytest

from drivers.base import Quality, Reading
from gateway.acquisition.board import Board
from gateway.config.applied import ConfigurationApplied
from gateway.config.file import parse
from gateway.model.events import DecisionMade, HealthChecked, OutlookChanged, StoreHealth
from gateway.model.probing import Outlook
from gateway.model.standing import Standing
from gateway.model.text import plain
from gateway.runtime.time_service import clock_synchronised
from gateway.service.health import HealthWatch
from talc.frame import Why
from tests.benches.kept_events import KeptEvents
from tests.benches.reloaded_service import service_of
from tests.benches.service_file import FILE, TEXT
from tests.benches.stepped_clock import EPOCH, SteppedClock
from tests.benches.tasks import served
from tests.benches.telemetry_examples import DECISION

STEP_S = 300.0


class WatchedHealth:
    """A watch over values that the test sets, without a control."""

    def __init__(self, channels: int = 2) -> None:
        self.clock, self.kept = SteppedClock(), KeptEvents()
        self.board = Board({f"t{n}": 1.0 for n in range(channels)})
        self.store = StoreHealth(free_mb=900.0)
        self.synchronised: bool | None = True
        self.watch = HealthWatch(
            STEP_S, self.board, None, self.clock, lambda: self.store, lambda: self.synchronised, self.kept
        )

    def read(self, channel: str, quality: Quality = Quality.GOOD, detail: str = "") -> None:
        value = 20.0 if quality is Quality.GOOD else math.nan
        self.board.put([Reading(channel, value, "degC", quality, EPOCH, self.clock.monotonic(), detail)])


def test_a_gateway_with_all_that_it_needs_waits_for_nothing() -> None:
    at = WatchedHealth()
    at.read("t0")
    at.read("t1")
    at.watch.decided(DecisionMade(DECISION))
    health = at.watch.health()
    assert (health.channels, health.channels_good, health.nc) == (2, 2, "none")
    assert (health.waits_for, health.store, health.clock_synchronised) == ((), at.store, True)


def test_each_thing_that_is_missing_is_named_with_its_reason() -> None:
    at = WatchedHealth()
    at.read("t1", Quality.SENSOR_FAULT, "wire break")
    at.store, at.synchronised = StoreHealth(plain("database or disk is full")), False
    at.watch.outlook_changed(
        OutlookChanged(Outlook(Standing.BLOCKED, Why.INTERVAL, plain("alarm 21612"), 2, plain("clean the sphere")))
    )
    at.clock.spend(2 * STEP_S + 12.0)
    health = at.watch.health()
    assert health.channels_good == 0
    assert health.waits_for == (
        "the first decision: the grid step ends at 06:15:00 UTC",
        "channel t0: no reading yet",
        "channel t1: sensor_fault: wire break",
        "a measurement (interval): blocked: alarm 21612",
        "an operator: clean the sphere",
        "storage: database or disk is full",
        "the time: no time server keeps this computer's clock",
    )


def test_a_good_value_that_grows_old_is_not_good_any_more() -> None:
    at = WatchedHealth(1)
    at.read("t0")
    assert at.watch.health().channels_good == 1
    at.clock.spend(3.0)
    health = at.watch.health()
    assert health.channels_good == 0
    assert "channel t0: stale: no new value for 3.0 s" in health.waits_for


def test_some_of_many_bad_channels_are_named_and_the_others_counted() -> None:
    waits = WatchedHealth(29).watch.health().waits_for
    assert len(waits) == 7
    assert waits[-2:] == ("channel t4: no reading yet", "24 more channels")


@pytest.mark.parametrize("synchronised", [True, None])
def test_an_unknown_clock_is_no_reason_to_wait(synchronised: bool | None) -> None:
    at = WatchedHealth(0)
    at.watch.decided(DecisionMade(DECISION))
    at.synchronised = synchronised
    assert at.watch.health().waits_for == ()


async def test_a_running_service_reports_its_health_at_once_and_then_every_ten_seconds() -> None:
    clock, kept = SteppedClock(), KeptEvents()
    async with served(service_of(parse(TEXT, FILE), kept, clock)):
        await clock.run_until(25.0)
    assert isinstance(kept.all[0], ConfigurationApplied)
    health = [event.health for event in kept.of(HealthChecked)]
    assert [h.uptime_s for h in health] == [0.0, 10.0, 20.0]
    assert {h.channels_good for h in health} == {0}
    assert any("channel bed_front" in text for text in health[-1].waits_for)


def test_the_clock_counts_as_synchronised_when_the_kernels_status_says_so() -> None:
    timex = ctypes.create_string_buffer(512)
    if ctypes.CDLL(None).adjtimex(timex) < 0:
        assert clock_synchronised() is None
        return
    (status,) = struct.unpack_from("@i", timex, struct.calcsize("@illll"))  # after modes, offset, freq and two errors
    unsynchronised = bool(status & 0x40)  # STA_UNSYNC of linux/timex.h
    assert clock_synchronised() is not unsynchronised
