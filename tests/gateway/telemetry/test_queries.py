"""Queries on schemas and on stored readings, over real Zenoh sessions on loopback."""

import json
import threading
from collections.abc import Callable
from datetime import UTC, date, datetime
from typing import Any

import pytest
import zenoh

from gateway.model.events import EventReported
from gateway.model.text import Text
from gateway.telemetry.answers import CoursePage, HistoryPage, ReportPage, StoredColumn, StoredRows, StoredTable
from gateway.telemetry.codec import MESSAGE_TYPES, decode_answer, decode_refusal
from gateway.telemetry.history_queries import CourseRequest, HistoryRequest
from gateway.telemetry.json_schema import schemas
from gateway.telemetry.messages import PublishedCourse
from gateway.telemetry.queries import MOST_ROWS
from gateway.telemetry.report_queries import ReportRequest
from gateway.telemetry.stored_queries import StoredRequest
from talc.frame import Event, EventKind
from tests.benches.free_port import free_port
from tests.benches.telemetry_peer import ROOT, last_values, telemetry
from tests.benches.zenoh_sessions import client

LIMIT_S = 60.0
DAY = "from=2026-03-02T00:00:00Z;to=2026-03-03T00:00:00+01:00"
PAGE = HistoryPage(0.0, ("a", "b"), ("degC", "um"), [1.5, 2.5], [0, 1], [20.0, None], ["good", "stale"], "r7")


def ask(port: int, selector: str) -> tuple[list[zenoh.Sample], list[Text]]:
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

    async with telemetry(port, history=find):
        found, errors = ask(port, f"{ROOT}/history?{DAY};channels=a,b;limit=5;after=r3")
    assert errors == []
    assert [(str(reply.key_expr), decode_answer(HistoryPage, reply.payload.to_bytes())) for reply in found] == [
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
        (
            "from=0001-01-01T00:00:00+14:00;to=2026-03-03T00:00:00Z",
            "history: from = '0001-01-01T00:00:00+14:00': expected",
        ),
        (
            "from=2026-03-02T00:00:00Z;to=9999-12-31T23:59:59-14:00",
            "history: to = '9999-12-31T23:59:59-14:00': expected",
        ),
        ("from=2026-03-02T00:00:00Z;to=2026-03-01T00:00:00Z", "expected later than from = '2026-03-02T00:00:00Z'"),
        (f"{DAY};limit=0", f"history: limit = '0': expected 1 to {MOST_ROWS}"),
        (f"{DAY};limit=1000000000000", f"expected 1 to {MOST_ROWS}"),
        (f"{DAY};limit=0000500001", "history: limit = '0000500001': expected 1"),
        (f"{DAY};limit=-5", "history: limit = '-5': expected 1"),
        (
            f"{DAY};chanels=a",
            "history: chanels: unknown; expected one of from, to, channels, limit, after, every, form",
        ),
        (
            f"{DAY};every=0",
            "history: every = '0': expected whole seconds, 1 to 3600, or whole minutes of up to 86400 s",
        ),
        (f"{DAY};every=nan", "history: every = 'nan': expected whole seconds"),
        (f"{DAY};form=columns", "history: form = 'columns': expected rows or blocks"),
        (f"{DAY};form=blocks;every=60", "history: form = 'blocks': gives only single readings; leave out every"),
        (f"{DAY};form=blocks;limit=500001", "history: limit = '500001': expected 1 to 500000"),
        (f"{DAY};every=3601", "history: every = '3601': expected whole seconds"),
        (f"{DAY};every=86460", "history: every = '86460': expected whole seconds"),
        (f"{DAY};every=١", "history: every = '١': expected whole seconds"),
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
    async with telemetry(port, history=find):
        found, errors = ask(port, f"{ROOT}/history?{parameters}")
    assert found == []
    assert [text for text in errors if said in text] == errors
    assert len(errors) == 1


BEGIN, END = datetime(2026, 3, 2, tzinfo=UTC), datetime(2026, 3, 2, 23, tzinfo=UTC)
ASKED: dict[str, tuple[CoursePage | ReportPage, dict[str, CourseRequest | ReportRequest], dict[str, str]]] = {
    "course": (
        CoursePage([1.5], {"EX0C": PublishedCourse([0.5], [None])}, [], {}),
        {
            f"{DAY};limit=50": CourseRequest(BEGIN, END, 50),
            f"{DAY};temperatures=yes": CourseRequest(BEGIN, END, 500, temperatures=True),
        },
        {
            f"{DAY};limit=2001": "expected 1 to 2000",
            f"{DAY};channels=a": "expected one of from, to, limit, temperatures",
            f"{DAY};temperatures=1": "temperatures = '1': expected yes or no",
        },
    ),
    "report": (
        ReportPage("2026-03-02", "Europe/Zurich", b"\x1f\x8b\x00\xff"),
        {
            "day=2026-03-02;zone=Europe/Zurich": ReportRequest(date(2026, 3, 2), "Europe/Zurich"),
            "day=2026-03-02;tolerance=8": ReportRequest(date(2026, 3, 2), "", tolerance_um=8.0),
        },
        {
            "": "day = '': expected a day such as 2026-03-02",
            "day=2026-02-30": "day = '2026-02-30': expected a day",
            "day=1999-12-31": "expected one between 2000 and 2199",
            "day=2026-03-02;zone=" + "a" * 65: "zone: expected at most 64 letters",
            "day=2026-03-02;tolerance=0": "tolerance = '0': expected µm",
            "from=2026-03-02": "from: unknown; expected one of day, zone",
        },
    ),
}
"""The page, right queries with what the source is asked for, and wrong queries with what is said."""


@pytest.mark.parametrize("kind", ASKED)
async def test_the_page_of_a_source_is_what_was_asked_for_and_a_wrong_query_says_what_is_wrong(kind: str) -> None:
    port, asked, (page, right, wrong) = free_port(), list[object](), ASKED[kind]

    def find(request: object) -> CoursePage | ReportPage:
        asked.append(request)
        return page

    source: dict[str, Any] = {kind: find}
    async with telemetry(port, **source):
        for query in right:
            found, errors = ask(port, f"{ROOT}/{kind}?{query}")
            assert errors == []
            assert [decode_answer(type(page), reply.payload.to_bytes()) for reply in found] == [page]
        for query, said in wrong.items():
            found, (error,) = ask(port, f"{ROOT}/{kind}?{query}")
            assert found == []
            assert error.startswith(f"{kind}: ")
            assert said in error
    assert asked == list(right.values())


async def test_an_unexpected_error_is_logged_with_the_query_and_what_to_do(caplog: pytest.LogCaptureFixture) -> None:
    def find(request: HistoryRequest) -> HistoryPage:
        raise KeyError(request.channels)

    port = free_port()
    async with telemetry(port, history=find):
        _, errors = ask(port, f"{ROOT}/history?{DAY};channels=a")
    assert errors == ["history: unexpected KeyError; please report it with the traceback in the gateway's log"]
    said = f"unexpected error while answering {ROOT}/history?{DAY};channels=a; please report this"
    assert [record.getMessage() for record in caplog.records if record.exc_info] == [said]


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

    async with telemetry(port, history=find):
        with client(port) as session:
            session.get(f"{ROOT}/history?{DAY}", take, timeout=LIMIT_S)
            assert began.wait(LIMIT_S)
            for _ in range(10):  # one is worked on and eight wait
                session.get(f"{ROOT}/history?{DAY}", take, timeout=LIMIT_S)
            with changed:
                assert changed.wait_for(come(2), LIMIT_S)
                assert answers == ["history: busy: 8 queries are waiting already; ask again"] * 2
                go_on.set()
                assert changed.wait_for(come(11), LIMIT_S)
    assert answers[2:] == ["page"] * 9


E = "0123456789abcdef" * 2
ROWS = StoredRows(
    {
        "events": StoredTable(
            E,
            4,
            True,
            None,
            [3, 4],
            (StoredColumn("text", "text", [0, None], ("hot",)), StoredColumn("k", "whole", [7, 8])),
        )
    }
)


async def test_stored_rows_are_those_after_the_position_that_was_asked_for() -> None:
    port, asked = free_port(), list[StoredRequest]()

    def find(request: StoredRequest) -> StoredRows:
        asked.append(request)
        return ROWS

    async with telemetry(port, stored=find):
        found, errors = ask(port, f"{ROOT}/stored?after=events:{E}:2,steps,models:{E}:-1;limit=5")
        assert ask(port, f"{ROOT}/*") == ([], [])
    assert errors == []
    assert [(str(reply.key_expr), decode_answer(StoredRows, reply.payload.to_bytes())) for reply in found] == [
        (f"{ROOT}/stored", ROWS)
    ]
    assert asked == [StoredRequest({"events": (E, 2), "steps": None, "models": (E, -1)}, 5)]


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ("", "stored: after = '': expected different tables, as TABLE or TABLE:EPOCH:NUMBER"),
        ("after=steps,steps", "stored: after = 'steps': expected different tables"),
        ("after=steps:1:2", "stored: after = 'steps:1:2': expected different tables"),
        (f"after=steps:{E}:9999999999999999999", "expected a number of a row"),
        (f"after=steps:{E}:1.5", "expected different tables, as TABLE or TABLE:EPOCH:NUMBER"),
        ("after=steps;limit=0", "stored: limit = '0': expected 1 to 50000"),
        ("after=steps;until=4", "stored: until: unknown; expected one of after, limit"),
        ("after=frames", "stored: frames: no such table"),
    ],
)
async def test_a_corrupt_position_is_answered_with_what_is_wrong(parameters: str, said: str) -> None:
    def find(request: StoredRequest) -> StoredRows:
        raise ValueError("frames: no such table")

    port = free_port()
    async with telemetry(port, stored=find):
        found, (error,) = ask(port, f"{ROOT}/stored?{parameters}")
    assert found == []
    assert said in error


async def test_each_schema_is_answered_and_describes_what_is_published() -> None:
    port = free_port()
    async with telemetry(port) as publisher:
        found, _ = ask(port, f"{ROOT}/schema/**")
        (only,), _ = ask(port, "talc/*/schema/status")
        publisher.publish(EventReported(Event(EventKind.PROBLEM, "the last"), 7))
        event: dict[str, Any] = last_values(port)[f"{ROOT}/event"]
    texts = {str(reply.key_expr).removeprefix(f"{ROOT}/schema/"): reply.payload.to_string() for reply in found}
    assert texts == schemas()
    assert only.payload.to_string() == texts["status"]
    commands = {"command", "command_terms", "command_request"}
    assert {*MESSAGE_TYPES, "history", "course", "report", "scenario", "stored", *commands, "error"} == set(texts)
    definitions = json.loads(texts["event"])["$defs"]["EventMessage"]
    assert set(event) == set(definitions["properties"])
    assert set(definitions["required"]) <= set(event)


async def test_a_query_for_all_keys_gets_last_values_and_neither_schemas_nor_history() -> None:
    port = free_port()
    async with telemetry(port, history=lambda _: PAGE) as publisher:
        publisher.publish(EventReported(Event(EventKind.PROBLEM, "the last"), 7))
        assert list(last_values(port)) == [f"{ROOT}/event"]
        assert ask(port, f"{ROOT}/*")[1] == []
