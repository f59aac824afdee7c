"""Queries on schemas and on stored readings, over real Zenoh sessions on loopback."""

import json
import threading
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any

import pytest
import zenoh

from drivers.base import SystemClock
from gateway.config import Telemetry
from gateway.events import EventReported
from gateway.telemetry import (
    MOST_ROWS,
    TYPES,
    HistoryPage,
    HistoryRequest,
    HistorySource,
    TelemetryPublisher,
    decode_page,
    decode_refusal,
    schemas,
)
from talc.frame import Event, EventKind
from tests.benches.free_port import free_port
from tests.benches.telemetry_peer import ROOT, last_values
from tests.benches.telemetry_process import client

LIMIT_S = 60.0
DAY = "from=2026-03-02T00:00:00Z;to=2026-03-03T00:00:00+01:00"
PAGE = HistoryPage(0.0, ("a", "b"), ("degC", "um"), [1.5, 2.5], [0, 1], [20.0, None], ["good", "stale"], "r7")


def with_history(port: int, source: HistorySource | None) -> TelemetryPublisher:
    settings = Telemetry(listen=(f"tcp/127.0.0.1:{port}",))
    return TelemetryPublisher(settings, "mill", (), SystemClock(), "boot-1", simulated=False, history=source)


def ask(port: int, selector: str) -> tuple[list[zenoh.Sample], list[str]]:
    """Replies, and what error replies say."""
    with client(port) as session:
        replies = list(session.get(selector, timeout=LIMIT_S))
    errors = [decode_refusal(reply.err.payload.to_bytes()) for reply in replies if reply.err is not None]
    return [reply.ok for reply in replies if reply.ok is not None], errors


async def test_a_page_is_what_was_asked_for() -> None:
    port, asked = free_port(), list[HistoryRequest]()

    def find(request: HistoryRequest) -> HistoryPage:
        asked.append(request)
        return PAGE

    async with with_history(port, find):
        found, errors = ask(port, f"{ROOT}/history?{DAY};channels=a,b;limit=5;after=r3")
    assert errors == []
    assert [(str(reply.key_expr), decode_page(reply.payload.to_bytes())) for reply in found] == [
        (f"{ROOT}/history", PAGE)
    ]
    begin, end = datetime(2026, 3, 2, tzinfo=UTC), datetime(2026, 3, 2, 23, tzinfo=UTC)
    assert asked == [HistoryRequest(begin, end, ("a", "b"), 5, "r3")]


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ("", "history: from: missing; expected a time with its offset from UTC, such as 2026-03-02T06:00:00Z"),
        ("from=today;to=2026-03-02T00:00:00Z", "history: from = 'today': expected a time"),
        ("from=2026-03-02T00:00:00;to=2026-03-03T00:00:00Z", "history: from = '2026-03-02T00:00:00': expected a time"),
        ("from=2026-03-02T00:00:00Z", "history: to: missing"),
        ("from=2026-03-02T00:00:00Z;to=2026-03-01T00:00:00Z", "expected later than from = '2026-03-02T00:00:00Z'"),
        (f"{DAY};limit=0", f"history: limit = '0': expected 1 to {MOST_ROWS}"),
        (f"{DAY};limit=1000000000000", f"expected 1 to {MOST_ROWS}"),
        (f"{DAY};limit=0000500001", "history: limit = '0000500001': expected 1"),
        (f"{DAY};limit=-5", "history: limit = '-5': expected 1"),
        (f"{DAY};chanels=a", "history: chanels: unknown; known are from, to, channels, limit, after"),
        (f"{DAY};channels=bed", "history: channels: 'bed' was never stored"),
        (f"{DAY};channels=gone", "history: gateway.sqlite: no such file"),
        (f"{DAY};channels=bug", "history: unexpected KeyError"),
    ],
)
async def test_a_wrong_query_is_answered_with_what_is_wrong(parameters: str, said: str) -> None:
    def find(request: HistoryRequest) -> HistoryPage:
        match request.channels:
            case ("bed",):
                raise ValueError("channels: 'bed' was never stored")
            case ("gone",):
                raise OSError("gateway.sqlite: no such file")
            case ("bug",):
                raise KeyError("bug")
            case _:
                return PAGE

    port = free_port()
    async with with_history(port, find):
        found, errors = ask(port, f"{ROOT}/history?{parameters}")
    assert found == []
    assert [text for text in errors if said in text] == errors
    assert len(errors) == 1


async def test_a_gateway_without_a_store_says_so() -> None:
    port = free_port()
    async with with_history(port, None):
        assert ask(port, f"{ROOT}/history?{DAY}") == ([], ["history: this gateway has no store"])


async def test_more_queries_than_can_wait_are_refused_at_once_and_the_others_answered() -> None:
    port, began, go_on = free_port(), threading.Event(), threading.Event()

    def find(request: HistoryRequest) -> HistoryPage:
        began.set()
        assert go_on.wait(LIMIT_S)
        return PAGE

    answers: list[str] = []
    changed = threading.Condition()

    def take(reply: zenoh.Reply) -> None:
        with changed:
            answers.append("page" if reply.err is None else decode_refusal(reply.err.payload.to_bytes()))
            changed.notify()

    def come(count: int) -> Callable[[], bool]:
        return lambda: len(answers) >= count

    async with with_history(port, find):
        with client(port) as session:
            session.get(f"{ROOT}/history?{DAY}", take, timeout=LIMIT_S)
            assert began.wait(LIMIT_S)
            for _ in range(10):  # one is worked on and eight wait
                session.get(f"{ROOT}/history?{DAY}", take, timeout=LIMIT_S)
            with changed:
                assert changed.wait_for(come(2), LIMIT_S)
                assert answers == ["history: busy: 8 queries wait already; ask again"] * 2
                go_on.set()
                assert changed.wait_for(come(11), LIMIT_S)
    assert answers[2:] == ["page"] * 9


async def test_each_schema_is_answered_and_describes_what_is_published() -> None:
    port = free_port()
    async with with_history(port, None) as publisher:
        found, _ = ask(port, f"{ROOT}/schema/**")
        (only,), _ = ask(port, "talc/*/schema/status")
        publisher.publish(EventReported(Event(EventKind.PROBLEM, "the last"), 7))
        event: dict[str, Any] = last_values(port)[f"{ROOT}/event"]
    texts = {str(reply.key_expr).removeprefix(f"{ROOT}/schema/"): reply.payload.to_string() for reply in found}
    assert texts == schemas()
    assert only.payload.to_string() == texts["status"]
    assert {*TYPES, "history", "error"} == set(texts)
    definitions = json.loads(texts["event"])["$defs"]["EventMessage"]
    assert set(event) == set(definitions["properties"])
    assert set(definitions["required"]) <= set(event)


async def test_a_query_for_all_keys_gets_last_values_and_neither_schemas_nor_history() -> None:
    port = free_port()
    async with with_history(port, lambda _: PAGE) as publisher:
        publisher.publish(EventReported(Event(EventKind.PROBLEM, "the last"), 7))
        assert list(last_values(port)) == [f"{ROOT}/event"]
        assert ask(port, f"{ROOT}/*")[1] == []
