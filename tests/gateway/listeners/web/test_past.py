"""The time before the page's program heard anything is asked of the gateway, at the chosen point."""

import asyncio
import math
import threading
from datetime import UTC
from typing import Any, Literal, cast

import msgspec
import pytest
from httpx2 import ASGITransport, AsyncClient
from starlette.testclient import TestClient

from gateway.listeners.web.app import build_app
from gateway.listeners.web.settings import MachineUse, WebSettings
from gateway.telemetry.answers import CoursePage
from gateway.telemetry.codec import encode
from gateway.telemetry.messages import PublishedCourse, StatusMessage
from gateway.telemetry.subscriber.site import SiteSubscription
from talc.names import THERMAL_ERRORS
from tests.benches.heard import BEGAN
from tests.benches.mill_page import mill_page, mill_seen
from tests.benches.stored_elsewhere import StoredElsewhere
from tests.benches.waits import LIMIT_S, until

FROM_S = BEGAN.timestamp()
SPAN = {"from": str(FROM_S - 3600.0), "to": str(FROM_S)}


def stored(value: float | None = 30.0) -> CoursePage:
    """Two estimates: EZ0A is 30 µm, then `value`; and a measurement of zero."""

    def errors(values: list[float | None]) -> dict[str, PublishedCourse]:
        nothing: list[float | None] = [0.0] * len(values)
        return {e: PublishedCourse(values if e == "EZ0A" else nothing, nothing) for e in THERMAL_ERRORS}

    return CoursePage([FROM_S - 600.0, FROM_S - 300.0], errors([30.0, value]), [FROM_S - 500.0], errors([0.0]))


def test_it_is_shown_at_the_chosen_point_in_columns() -> None:
    source = StoredElsewhere(lambda: stored(None))
    answer = mill_page(source).get("/past/mill", params=SPAN | {"x": "200", "z": "50"})
    shown: dict[str, Any] = answer.json()
    assert shown["t"] == [FROM_S - 600.0, FROM_S - 300.0]
    assert shown["without"][2] == [30.0, None]
    assert (shown["measured_t"], shown["measured"][2]) == ([FROM_S - 500.0], [0.0])
    ((machine, begin, end, limit),) = source.asked
    assert (machine, end, (end - begin).total_seconds(), limit) == ("mill", BEGAN.astimezone(UTC), 3600.0, 500)


def test_problems_and_orders_of_then_are_marked() -> None:
    marked = [(FROM_S - 400.0, "problem"), (FROM_S - 300.0, "command"), (math.nan, "problem"), (FROM_S, "later kind")]
    answer = mill_page(StoredElsewhere(lambda: msgspec.structs.replace(stored(), marked=marked)))
    shown = answer.get("/past/mill", params=SPAN).json()["marks"]
    assert shown == [[FROM_S - 400.0, "bad"], [FROM_S - 300.0, "notice"]]


def test_temperatures_come_only_if_they_are_asked_for_and_are_as_many_as_the_times() -> None:
    def with_temperatures(column: list[float | None]) -> CoursePage:
        return msgspec.structs.replace(stored(), temperatures={"bed": column})

    page = mill_page(StoredElsewhere(lambda: with_temperatures([21.0, None])))
    assert page.get("/past/mill", params=SPAN | {"temperatures": "1"}).json()["temperatures"] == {"bed": [21.0, None]}
    short = mill_page(StoredElsewhere(lambda: with_temperatures([21.0])))
    answer = short.get("/past/mill", params=SPAN | {"temperatures": "1"})
    assert (answer.status_code, answer.json()) == (503, {"s": "bed: 1 numbers for 2 times"})


def test_the_nine_errors_come_only_if_they_are_asked_for() -> None:
    page = mill_page(StoredElsewhere(lambda: stored(None)))
    errors = page.get("/past/mill", params=SPAN | {"errors": "1"}).json()["errors"]
    assert (len(errors), errors["EZ0A"], errors["ER0T"]) == (9, [30.0, None], [0.0, 0.0])
    assert page.get("/past/mill", params=SPAN).json()["errors"] == {}


def test_without_a_choice_it_is_shown_where_the_probing_sphere_is() -> None:
    """A tilt about Y of 100 µm/m moves the tool by 8 µm in X at 80 mm, and by 12 µm in Z at 120 mm."""
    tilt = {e: PublishedCourse([100.0 * (e == "EB0C")], [0.0]) for e in THERMAL_ERRORS}
    source = cast(SiteSubscription, StoredElsewhere(lambda: CoursePage([FROM_S], tilt, [], {})))
    site = mill_seen()
    use = MachineUse(sphere_radius_mm=120.0, sphere_height_mm=80.0)
    client = TestClient(build_app(site, WebSettings(), source, {"mill": use}), base_url="http://localhost")
    (x,), _, (z,) = client.get("/past/mill", params=SPAN).json()["without"]
    assert (abs(x), abs(z)) == (8.0, 12.0)
    known = ((200.0, 50.0), (5.0, 20.0)), ((0.0, 50.0), (8.0, 12.0)), (None, (8.0, 12.0))
    for number, (told, expected) in enumerate(known, start=1):
        status = StatusMessage(
            "boot-1", number, BEGAN.isoformat(), "system", None, None, 0, {}, None, None, sphere_mm=told
        )  # what the gateway tells counts, unless it is absurd or the gateway is older
        site.take("talc/mill/status", encode(status))
        (x,), _, (z,) = client.get("/past/mill", params=SPAN).json()["without"]
        assert (abs(x), abs(z)) == expected


async def test_a_gateway_is_asked_by_two_at_once_and_the_others_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    asked, answer, waits = list[int](), threading.Event(), asyncio.Event()

    class Told(asyncio.Semaphore):
        async def acquire(self) -> Literal[True]:
            if self.locked():
                waits.set()
            return await super().acquire()

    def slow() -> CoursePage:
        asked.append(1)
        answer.wait()
        return stored()

    monkeypatch.setattr(asyncio, "Semaphore", Told)
    app = build_app(mill_seen(), WebSettings(), cast(Any, StoredElsewhere(slow)))
    async with AsyncClient(transport=ASGITransport(app), base_url="http://localhost") as client:
        zooming = [asyncio.create_task(client.get("/past/mill", params=SPAN)) for _ in range(3)]
        try:
            await until(lambda: len(asked) == 2)
            async with asyncio.timeout(LIMIT_S):
                await waits.wait()
            assert len(asked) == 2
        finally:
            answer.set()
        assert [each.status_code for each in await asyncio.gather(*zooming)] == [200] * 3


@pytest.mark.parametrize(
    "asked",
    [
        {},
        {"from": "x", "to": "1"},
        {"from": "nan", "to": "nan"},
        {"from": "2e9", "to": "1e9"},
        {"from": "0", "to": "1e9"},
        {"from": "1_000_000_000", "to": "1.2e9"},
        {"from": "١e9", "to": "1.2e9"},
        {"from": "1e9", "to": "1e30"},
        SPAN | {"x": "far"},
    ],
)
def test_an_invalid_span_is_refused_and_nobody_asked(asked: dict[str, str]) -> None:
    source = StoredElsewhere(stored)
    assert mill_page(source).get("/past/mill", params=asked).status_code == 400
    assert source.asked == []


def test_what_the_gateway_says_when_it_cannot_is_passed_on_as_text() -> None:
    def refuse() -> CoursePage:
        raise OSError("course: <b>no such file</b>")

    answer = mill_page(StoredElsewhere(refuse)).get("/past/mill", params=SPAN)
    assert (answer.status_code, answer.json()) == (503, {"s": "course: <b>no such file</b>"})


@pytest.mark.parametrize("spoilt", ["short", "none"])
def test_an_answer_with_columns_of_other_lengths_is_refused_and_one_without_errors_is_unknown(spoilt: str) -> None:
    short = {"EZ0A": PublishedCourse([1.0], [1.0])} if spoilt == "short" else {}
    answer = mill_page(StoredElsewhere(lambda: CoursePage([1.0, 2.0], short, [], {}))).get("/past/mill", params=SPAN)
    if spoilt == "short":
        assert answer.status_code == 503
    else:
        assert answer.json()["without"][2] == [None, None]


def test_without_a_connection_or_for_an_impossible_name_there_is_no_past() -> None:
    assert mill_page(None).get("/past/mill", params=SPAN).status_code == 503
    assert mill_page(StoredElsewhere(stored)).get("/past/a%20b", params=SPAN).status_code == 404
    assert mill_page(StoredElsewhere(stored)).post("/past/mill", params=SPAN).status_code == 405
