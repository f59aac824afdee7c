"""Messages of others to a gateway, its collector, its outlets and its page: one example of each kind, by a seed."""

import asyncio
import json
import random
import socket
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from math import isfinite
from pathlib import Path
from typing import Any
from urllib.parse import quote

import msgspec

from drivers.base import DriverError
from drivers.faults import Fault
from drivers.mqtt.profile import MqttTopic
from drivers.mtconnect.document import described, observed
from drivers.mtconnect.exchange import ask_agent
from drivers.mtconnect.items import factors, number
from drivers.mtconnect.settings import MtConnectSettings
from drivers.mtconnect.suggest import suggested_items
from gateway.listeners.collect.tables import arrow_of, by_day, check_end
from gateway.listeners.outlets.influxdb import InfluxDbOutlet, InfluxDbSettings
from gateway.listeners.outlets.line_protocol import lines
from gateway.listeners.outlets.outlet import OutletError, OutletMessage
from gateway.listeners.web.app import build_app
from gateway.listeners.web.at_tool import WorkPoint
from gateway.listeners.web.audit import corrections
from gateway.listeners.web.parts import events
from gateway.listeners.web.past import shown_past
from gateway.listeners.web.sensitivity import sensitivity_by_week
from gateway.listeners.web.settings import WebSettings
from gateway.listeners.web.verdict import Viewpoint
from gateway.listeners.web.view import listed, shown_course, view
from gateway.listeners.web.weeks import scatter_by_week
from gateway.model.commands import UNPROVED, Command, CommandName, CommandOutcome
from gateway.model.text import json_text, plain
from gateway.telemetry.answers import CommandTerms, CoursePage, StoredColumn, StoredRows, StoredTable
from gateway.telemetry.codec import decode, decode_answer
from gateway.telemetry.command_door import CommandDoor, Entitled
from gateway.telemetry.command_signer import CommandSigner
from gateway.telemetry.history_queries import parse_course, parse_selector
from gateway.telemetry.messages import PublishedCourse
from gateway.telemetry.queries import AskedQuery
from gateway.telemetry.report_queries import parse_report
from gateway.telemetry.stored_queries import parse_stored
from talc.names import THERMAL_ERRORS
from tests.benches.feed_talk import reading
from tests.benches.fuzzed_files import Example, mutated, refused_by
from tests.benches.heard import BEGAN
from tests.benches.mill_page import mill_seen
from tests.benches.mtconnect_agent import ITEMS, devices
from tests.benches.played_telemetry import recorded

_ODD: tuple[object, ...] = (
    None, True, -1, 0, 2**62, 2**70, 1e300, -1e300, 1e-300, "", "x", "nan", "\0", "\ud7ff", "a" * 3000, [], {}, [None],
    {"": None}, "0001-01-01T00:00:00", "9999-12-31T23:59:59-14:00", "1970-01-01T00:00:00+00:00",
)  # fmt: skip
_LIMIT_S = 30.0
_MATRIX = WorkPoint(120.0, 0.0, 80.0).matrix(0.12)
_PATHS = (
    "/", "/machine/mill", "/machine/mill/report/2026-03-02", "/file/0/page.css", "/past/mill", "/scatter/mill",
    "/sensitivity/mill", "/corrections/mill", "/command/mill/pause", "/nothing", "//", "/machine/..%2f",
)  # fmt: skip
_QUERIES = (
    "tolerance=8&x=120&y=0&z=80&a=0&c=0&lang=de", "from=1767600000&to=1767603600", "zone=Europe/Zurich",
    "before=2026-01-05T08:00:00Z",
    'asked={"mill":{"x":"1","tolerance":"5"}}',
)  # fmt: skip


def misvalued(whole: Any, draw: random.Random) -> Any:
    """JSON data in which some values have another type or size, are missing, or occur twice."""
    if isinstance(whole, dict) and whole and draw.random() < 0.8:
        name = draw.choice(list(whole))
        if draw.random() < 0.1:
            return {key: value for key, value in whole.items() if key != name}
        return {**whole, name: misvalued(whole[name], draw)}
    if isinstance(whole, list) and whole and draw.random() < 0.8:
        at = draw.randrange(len(whole))
        kept = [whole[at]] * draw.choice((0, 1, 1, 1, 2))
        return [*whole[:at], *(misvalued(value, draw) for value in kept), *whole[at + 1 :]]
    return draw.choice(_ODD)


def _spoilt(whole: object, draw: random.Random) -> bytes:
    """A JSON text with other values or other bytes."""
    for _ in range(draw.randint(0, 3)):
        whole = misvalued(whole, draw)
    text = json.dumps(whole).encode("utf-8", "replace")
    return mutated(text, draw) if draw.random() < 0.4 else text


@cache
def _documents() -> tuple[bytes, bytes]:
    """Answers to `probe` and `current`."""
    values = "".join(
        f'<Position dataItemId="{item}">{"12.5" if units else "ACTIVE"}</Position>' for item, _, units in ITEMS
    )
    probe = f'<?xml version="1.0"?><m:MTConnectDevices xmlns:m="urn:x">{devices()}</m:MTConnectDevices>'
    return probe.encode(), f"<MTConnectStreams><Streams>{values}</Streams></MTConnectStreams>".encode()


@cache
def _items() -> MtConnectSettings:
    positions = {axis: f"{axis}pos" for axis in "XYZAC"}
    states = {"spindle_speed": "Srpm", "speed_X": "Xfrt", "speed_C": "Cfrt", "coolant": "flood"}
    return MtConnectSettings(url="http://127.0.0.1:5000", positions=positions, states=states, mode="mode", tool="tool")


def _mtconnect(draw: random.Random, _: Path) -> None:
    probe, current = (mutated(document, draw) for document in _documents())
    with refused_by(ValueError):
        suggested_items(probe)
    with refused_by(ValueError, DriverError):
        factors(_items(), described(probe).items)
    with refused_by(ValueError):
        for item, text in observed(current).values.items():
            with refused_by(DriverError):
                assert isfinite(number(item, text, 60.0))


@contextmanager
def _answering(answer: bytes) -> Iterator[int]:
    """A server that answers the first request with these bytes, and closes; its port."""

    def serve() -> None:
        line, _ = listening.accept()
        with line:
            line.settimeout(_LIMIT_S)
            try:
                line.recv(65_536)
                line.sendall(answer)
            except OSError:  # whoever asked has given up
                pass

    with socket.create_server(("127.0.0.1", 0)) as listening:
        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield listening.getsockname()[1]
        thread.join()


def _http(draw: random.Random, _: Path) -> None:
    """HTTP answers of an MTConnect agent, and of a server that accepts line protocol."""
    kind = draw.randrange(3)
    body = draw.choice((_documents()[1], b'{"code":"invalid","message":"field type conflict"}', b""))
    status = draw.choice((b"200 OK", b"204 No Content", b"400 Bad Request", b"503 Busy"))
    head = b"HTTP/1.1 " + status + b"\r\nContent-Type: text/xml\r\nRetry-After: 3\r\nConnection: close\r\n"
    if kind:
        answer = head + b"Content-Length: %d\r\n\r\n" % len(body) + body
    else:
        answer = head + b"Transfer-Encoding: chunked\r\n\r\n%x\r\n" % len(body) + body + b"\r\n0\r\n\r\n"
    with _answering(mutated(answer, draw)) as port:
        url = f"http://127.0.0.1:{port}"
        if draw.random() < 0.5:
            with refused_by(DriverError):
                asyncio.run(ask_agent(url, "mill", "current", _LIMIT_S))
        else:
            settings = {"name": "plant", "kind": "influxdb", "url": url, "database": "talc", "timeout_s": _LIMIT_S}
            outlet = InfluxDbOutlet(InfluxDbSettings.model_validate(settings))
            try:
                with refused_by(OutletError):
                    outlet.send([reading(1)])
            finally:
                outlet.close()


def _mqtt(draw: random.Random, _: Path) -> None:
    whole = {"sensors": [{"temperature": 21.5, "at": "2026-03-02T06:00:00Z"}], "n": "21,5", "t": 1772431200}
    places = {
        "number": draw.choice((None, "sensors.0.temperature", "n", "sensors.9", "t")),
        "time": draw.choice((None, "t", "sensors.0.at")),
    }
    given = {"topic": "a/b", "scale": draw.choice((1.0, 1e300)), **{k: v for k, v in places.items() if v is not None}}
    topic = MqttTopic.model_validate({**given, "time_unit": draw.choice(("s", "ms", "us", "ns"))})
    value, measured = topic.read(draw.choice((_spoilt(whole, draw), mutated(b"21.5", draw))))
    if isinstance(value, Fault):
        assert value.detail
    else:
        assert measured is not None or topic.time is None
        assert isinstance(value, float)


def _heard(draw: random.Random, _: Path) -> None:
    """Messages of a gateway: what the page then shows, and the lines that InfluxDB gets."""
    site = mill_seen()
    for key, message in draw.sample(recorded(), 12):
        payload = _spoilt(message, draw) if draw.random() < 0.7 else json.dumps(message).encode()
        site.take(f"talc/mill/{key}", payload)
        with refused_by(ValueError):
            told = OutletMessage("mill", key, decode(key, payload), payload)
            for line in lines(told):
                assert "\n" not in line
    with site.machines() as machines:
        for seen in machines.values():
            viewpoint = Viewpoint(_MATRIX, 8.0)
            shown = (
                view(seen, viewpoint, 0.0),
                tuple(events(seen)),
                tuple(corrections(seen)),
                shown_course(seen, viewpoint),
                listed(machines, {"mill": viewpoint}, 0.0),
            )
            msgspec.json.encode(shown, enc_hook=json_text)


@cache
def _replies() -> tuple[dict[str, Any], dict[str, Any]]:
    """Stored rows, and a course, as JSON data."""
    columns = (
        StoredColumn("time", "time", [1.7e9, 1.7e9 + 300.0]),
        StoredColumn("k", "whole", [1, 2]),
        StoredColumn("text", "text", [0, None], ("begun",)),
        StoredColumn("value", "number", [1.5, None]),
    )
    rows = StoredRows({"events": StoredTable("e" * 32, 2, numbers=[1, 2], columns=columns)})
    course = {error: PublishedCourse([1.0, None], [0.5, 0.5]) for error in THERMAL_ERRORS}
    page = CoursePage([1.7e9, 1.7e9 + 300.0], course, [1.7e9], {e: PublishedCourse([0.0], [0.1]) for e in course})
    stored: dict[str, Any] = json.loads(msgspec.json.encode(rows))
    shown: dict[str, Any] = json.loads(msgspec.json.encode(page))
    return stored, {**shown, "temperatures": {"bed": [20.0, 21.0]}}


def _answers(draw: random.Random, _: Path) -> None:
    """What gateways answer a collector and a page."""
    stored, course = _replies()
    with refused_by(ValueError):
        for table in decode_answer(StoredRows, _spoilt(stored, draw)).tables.values():
            rows = arrow_of(table, None)
            check_end(table, None)
            for day, _rows in by_day(rows):
                assert "1970-01-01" <= day <= "2200-01-01"
    with refused_by(ValueError):
        page = decode_answer(CoursePage, _spoilt(course, draw))
        for shown in (
            lambda: shown_past(page, _MATRIX),
            lambda: sensitivity_by_week(page),
            lambda: scatter_by_week(page),
        ):
            with refused_by(ValueError):
                msgspec.json.encode(shown())


def _queries(draw: random.Random, _: Path) -> None:
    """Queries that anyone may send a gateway, and commands of clients with no key or another one."""
    asked = (
        (parse_selector, b"from=2026-03-02T06:00:00Z;to=2026-03-02T07:00:00Z;channels=bed,column;limit=100;every=60"),
        (parse_course, b"from=2026-03-02T06:00:00Z;to=2026-03-02T07:00:00Z;limit=100;temperatures=yes"),
        (parse_report, b"day=2026-03-02;zone=Europe/Zurich"),
        (parse_stored, b"after=events:" + b"e" * 32 + b":12,steps;limit=100"),
    )
    parse, right = draw.choice(asked)
    with refused_by(ValueError):
        parse(mutated(right, draw).decode("utf-8", "replace"))
    given: list[Command] = []

    def give(command: Command, refused: str) -> CommandOutcome:
        given.append(command)
        return CommandOutcome(command, BEGAN, not refused, plain(refused))

    door = CommandDoor("mill", {"anna": Entitled(b"a" * 64, frozenset(CommandName))}, give, lambda: 1.0)
    terms = decode_answer(CommandTerms, door.answer(AskedQuery("", "", b"", b"")).payload)
    signed = CommandSigner("anna", b"a" * 64).sign(CommandName.PAUSE, terms, "mill")
    whole = draw.random() < 0.1
    payload = signed.payload if whole else mutated(signed.payload, draw)
    with refused_by(ValueError):
        door.answer(AskedQuery("pause", "", payload, signed.signature))
    let_in = [command for command in given if command.by != UNPROVED]
    assert len(let_in) == (payload == signed.payload), "only what was signed is obeyed"


def _web(draw: random.Random, _: Path) -> None:
    """Requests to the page: address, query and headers."""
    raw = mutated(draw.choice(_QUERIES).encode(), draw)
    query = quote(raw, safe="=&+%:{}\"',") if draw.random() < 0.5 else raw.decode("latin-1")
    headers = [(b"host", b"localhost"), (b"accept-language", b"de;q=0.8,en"), (b"authorization", b"Basic YTpi")]
    at = draw.randrange(len(headers))
    headers[at] = headers[at][0], mutated(headers[at][1], draw)[:4000]
    path = draw.choice(_PATHS)
    if draw.random() < 0.3:
        path = "/" + mutated(path.encode(), draw).decode("utf-8", "replace")
    scope = {
        "type": "http", "asgi": {"version": "3.0"}, "http_version": "1.1", "scheme": "http", "root_path": "",
        "method": draw.choice(("GET", "HEAD", "POST")), "path": path, "raw_path": path.encode("utf-8", "replace"),
        "query_string": query.encode("latin-1", "replace"), "headers": headers, "client": ("127.0.0.1", 1),
        "server": ("127.0.0.1", 80), "state": {},
    }  # fmt: skip
    status = asyncio.run(_answered(scope))
    assert status < 500 or status == 503, f"{status} of {path}?{query}"


async def _answered(scope: dict[str, Any]) -> int:
    app = build_app(mill_seen(), WebSettings())
    found: list[int] = []

    async def receive() -> Mapping[str, object]:
        return {"type": "http.request", "body": b"", "more_body": False}

    async def send(message: Mapping[str, Any]) -> None:
        if message["type"] == "http.response.start":
            found.append(message["status"])

    await app(scope, receive, send)  # type: ignore[arg-type]
    return found[0]


MESSAGES: Mapping[str, Example] = {
    "mtconnect": _mtconnect,
    "http": _http,
    "mqtt": _mqtt,
    "heard": _heard,
    "answers": _answers,
    "queries": _queries,
    "web": _web,
}
