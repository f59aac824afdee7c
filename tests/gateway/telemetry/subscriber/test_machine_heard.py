"""What is kept of what was heard: the newest of the present run, within its bounds."""

from datetime import timedelta

import pytest

from gateway.config.telemetry import Telemetry
from gateway.telemetry.codec import encode
from gateway.telemetry.messages import EventMessage
from gateway.telemetry.subscriber.machine import KEPT
from gateway.telemetry.subscriber.site import SiteSeen, listened_to
from tests.benches.heard import BEGAN, STEP, HeardMachine


def test_an_old_value_that_a_query_brings_does_not_replace_a_newer_one() -> None:
    heard = HeardMachine()
    heard.reading("bed", 20.0)
    old = heard.seen.readings["bed"]
    heard.reading("bed", 21.0)
    heard.hear("reading/bed", old)
    assert heard.seen.readings["bed"].value == 21.0


def test_an_event_that_comes_live_and_by_the_query_is_kept_once() -> None:
    heard = HeardMachine()
    heard.event()
    heard.hear("event", heard.seen.events[0])
    assert len(heard.seen.events) == 1


def test_another_run_of_the_gateway_begins_without_what_the_former_one_said() -> None:
    heard = HeardMachine()
    heard.reading("bed")
    heard.decision()
    heard.compensation()
    heard.event()
    heard.boot = "boot-2"
    heard.passes(STEP)
    heard.reading("column")
    seen = heard.seen
    assert (seen.decision, seen.compensation, list(seen.readings)) == (None, None, ["column"])
    assert len(seen.events) == 1, "the past is kept"
    assert len(seen.estimates) == 1


def test_after_a_gateway_was_away_nothing_holds_until_it_is_heard_again() -> None:
    """It may be a new run that has published nothing yet; or the network broke, and a query brings the last values."""
    heard = HeardMachine()
    heard.reading("bed")
    heard.decision()
    heard.measurement()
    heard.event()
    seen = heard.seen
    last = [("decision", seen.decision), ("measurement", seen.last_measurement), ("event", seen.events[0])]
    heard.passes(timedelta(seconds=20))
    seen.disappear(heard.now)
    assert list(seen.readings) == ["bed"], "the page shows it as it was last heard"
    seen.appear(heard.now)
    assert (seen.decision, list(seen.readings)) == (None, [])
    for suffix, message in last:
        assert message is not None
        heard.hear(suffix, message)
    assert seen.decision is not None
    assert (len(seen.estimates), len(seen.measurements), len(seen.events)) == (1, 1, 1)


def test_a_clock_that_is_set_back_makes_nothing_old() -> None:
    """A computer without a clock of its own starts in the future, until a time server sets it."""
    heard = HeardMachine()
    heard.passes(timedelta(hours=3))
    heard.decision(36)
    heard.now -= timedelta(hours=2)
    heard.decision(13)
    assert heard.seen.age_s(heard.now.isoformat(), heard.now_s) == 0.0
    assert [e.at for e in heard.seen.estimates] == [heard.now], "what would be later than now is not shown"


def test_what_the_control_did_with_a_decision_counts_even_when_it_is_heard_later() -> None:
    """A query brings the last values in any order."""
    heard = HeardMachine()
    heard.decision(7, {"EZ0A": 30.0})
    following = [heard.seen.estimates[-1].applied.following]
    for source, k in (("prediction", 7), ("stale", None)):
        heard.compensation((0.0, 0.0, 30.0), source=source, k=k)
        following.append(heard.seen.estimates[-1].applied.following)
    assert following == [False, True, True], "a step that uses no decision says nothing of one"


def test_eight_hours_are_kept() -> None:
    heard = HeardMachine()
    for k in range(200):
        heard.decision(k)
        heard.passes(STEP)
    assert heard.seen.estimates[0].at == heard.seen.estimates[-1].at - KEPT
    assert heard.seen.step_s == STEP.total_seconds()


def test_what_anybody_publishes_is_bounded() -> None:
    heard = HeardMachine()
    for i in range(1500):
        heard.reading(f"channel{i}")
        heard.event(text=f"event {i}")
    assert len(heard.seen.readings) <= 1000
    assert len(heard.seen.events) == 200


def test_invalid_times_are_ignored() -> None:
    heard = HeardMachine()
    for time in ("", "yesterday", "0001-01-01T00:00:00+00:00", "9999-12-31T23:59:59+00:00"):
        heard.hear("event", EventMessage("boot-1", 7, time, "system", None, "problem", "x", None, None, None))
    assert not heard.seen.events
    heard.decision(0)
    heard.passes(STEP)
    heard.decision(1)
    assert heard.seen.at_k(10**18) is None
    assert heard.seen.at_k(3) == BEGAN + 3 * STEP


def test_a_site_takes_messages_of_any_machine_and_only_logs_what_is_invalid(caplog: pytest.LogCaptureFixture) -> None:
    site = SiteSeen("hall/a", ("mill",), lambda: BEGAN, lambda: 0.0)
    event = EventMessage("b", 1, BEGAN.isoformat(), "system", None, "problem", "x", None, None, None)
    site.take("hall/a/lathe/event", encode(event))
    site.take("hall/a/lathe/event", b"{")
    site.take("hall/a/lathe/of_a_later_version", b"{}")
    site.take("hall/a/no such name/event", encode(event))
    for i in range(400):
        site.life(f"hall/a/m{i}/alive", alive=True)
    with site.machines() as machines:
        assert list(machines)[:3] == ["mill", "lathe", "m0"]
        assert len(machines["lathe"].events) == 1
        assert len(machines) == 300
    assert caplog.text.count("more than 300 machines") == 1, "no machine is left out without a word"


def test_a_gateway_on_this_computer_is_reached_on_its_own_addresses() -> None:
    settings = Telemetry(
        listen=("tcp/0.0.0.0:7447", "tcp/[::]:7448", "tcp/10.0.0.5:7449"), connect=("tcp/router:7447",)
    )
    assert listened_to(settings) == ("tcp/127.0.0.1:7447", "tcp/[::1]:7448", "tcp/10.0.0.5:7449", "tcp/router:7447")


def test_the_clock_of_the_gateway_goes_on_between_its_messages() -> None:
    heard = HeardMachine()
    heard.decision()
    assert heard.seen.age_s(BEGAN.isoformat(), heard.now_s + 90.0) == 90.0
    assert heard.seen.clock(heard.now_s + 60.0) == BEGAN + timedelta(minutes=1)
