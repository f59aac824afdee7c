"""What leaves a gateway fits the types that the schemas of docs/telemetry are made of: heard with only Zenoh."""

import asyncio
import json
import math
from datetime import datetime
from pathlib import Path
from typing import Any

from drivers.base import Quality, SystemClock
from gateway.config.applied import ConfigurationApplied
from gateway.config.telemetry import Operator, Telemetry
from gateway.model.commands import CommandName
from gateway.model.control_state import NcState
from gateway.model.events import (
    CompensationStepped,
    DecisionMade,
    EventReported,
    ForecastMade,
    FrameMade,
    GatewayEvent,
    Health,
    HealthChecked,
    MeasurementEnded,
    ModelsAdopted,
    OutlookChanged,
    ProbingRequested,
    ReadingsTaken,
    ReasonsGiven,
    SensorsJudged,
    StorageChanged,
    StoreHealth,
)
from gateway.model.text import plain
from gateway.runtime.clocks import RealClock
from gateway.service.stored_answers import course_of, history_of, rows_of
from gateway.storage.store import Store, boot_id
from gateway.telemetry.answers import ReportPage, ScenarioPage
from gateway.telemetry.codec import ANSWERS, MESSAGE_TYPES, decode, decode_answer, encode
from gateway.telemetry.messages import PublishedCourse
from gateway.telemetry.scenario_queries import ScenarioRequest
from tests.benches import telemetry_examples as example
from tests.benches.free_port import free_port
from tests.benches.open_publisher import OpenPublisher
from tests.benches.telemetry_examples import configuration
from tests.benches.telemetry_peer import ROOT, reading
from tests.benches.zenoh_sessions import client

SCHEMAS = {
    path.name.split(".")[0]: json.loads(path.read_text(encoding="utf-8"))
    for path in (Path(__file__).parents[3] / "docs" / "telemetry").glob("*.schema.json")
}
FIRST = (Path(__file__).parent / "fields.txt").read_text(encoding="utf-8").splitlines()
"""Fields of version 1 of the key space: lines are only ever added. A field that is new begins with `optional`."""
LIMIT_S = 60.0
SPAN = "from=2026-01-01T00:00:00Z;to=2026-02-01T00:00:00Z"
EVENTS: tuple[GatewayEvent, ...] = (
    ConfigurationApplied(configuration("mill")),
    ReadingsTaken([reading(20.0), reading(math.nan, Quality.SENSOR_FAULT), example.READING, example.BAD_READING]),
    FrameMade(example.FRAME),
    FrameMade(example.MEASURED_FRAME),
    DecisionMade(example.FIRST_DECISION),
    DecisionMade(example.DECISION),
    ProbingRequested(41),
    *(MeasurementEnded(outcome) for outcome in (example.OUTCOME, example.PER_POSE, example.REFUSED)),
    ModelsAdopted(example.MODELS, 7),
    CompensationStepped(example.WRITE),
    CompensationStepped(example.ADVICE),
    SensorsJudged(example.JUDGEMENT, 7),
    ReasonsGiven(example.REASONS),
    ForecastMade(example.FORECAST, example.MISSES),
    OutlookChanged(example.OUTLOOK),
    OutlookChanged(example.NO_WISH),
    StorageChanged(StoreHealth(plain("database is locked"), 5.0, 40, 0, 900.0)),
    HealthChecked(Health(60.0, 30, 29, NcState.READY, True, (plain("an operator"),), StoreHealth())),
    *(EventReported(event, k) for event, k in ((example.PROBLEM, None), (example.LIMIT, 7), (example.NO_NUMBER, 7))),
)
"""Events of each kind, with and without what may be missing."""
STORED = "measurements,steps,models,events,compensation,minutes,readings,commands,runs"
ASKED = {
    "history": f"history?{SPAN}",
    "course": f"course?{SPAN};temperatures=yes;reasons=yes",
    "stored": f"stored?after={STORED}",
    "report": "report?day=2026-01-05",
    "scenario": "scenario?load=warm-up;minutes=20",
    "command_terms": "command",
    "error": "history?from=yesterday",
}


async def foreseen(asked: ScenarioRequest) -> ScenarioPage:
    course = {"EZ0A": PublishedCourse([1.0, None], [0.5, 0.5])}
    loads = {"spindle_speed": 6000.0}
    return ScenarioPage("2026-01-05T06:00:00+00:00", 7, (300.0, 600.0), asked.minutes, loads, course, {})


def typed(suffix: str, payload: bytes) -> Any:
    """Raises ValueError if it does not fit its type, of which the schema is made."""
    if suffix in ANSWERS:
        return decode_answer(ANSWERS[suffix], payload)
    return decode(suffix, payload)


async def test_every_message_and_every_answer_fits_its_schema(tmp_path: Path) -> None:
    key, path, boot = tmp_path / "anna.key", tmp_path / "gateway.sqlite", boot_id()
    key.write_text("anna" * 10, encoding="utf-8")
    anna = Operator(name="anna", key_file=key, may=(CommandName.PAUSE,))
    where = f"tcp/127.0.0.1:{free_port()}"
    heard: list[tuple[str, bytes]] = []

    def judge() -> None:
        with client(int(where.rpartition(":")[2])) as session:

            def take(sample: Any) -> None:
                heard.append((str(sample.key_expr).removeprefix(f"{ROOT}/"), sample.payload.to_bytes()))

            subscriber = session.declare_subscriber(f"{ROOT}/**", take)
            list(session.get(f"{ROOT}/**", timeout=LIMIT_S))  # the subscription has arrived
            for event in EVENTS:
                publisher.publish(event)
            while not heard or heard[-1][0] != "event" or example.NO_NUMBER.text.encode() not in heard[-1][1]:
                list(session.get(f"{ROOT}/status", timeout=LIMIT_S))
            subscriber.undeclare()
            for kind, selector in ASKED.items():
                (reply,) = session.get(f"{ROOT}/{selector}", timeout=LIMIT_S)
                payload = reply.ok.payload if reply.ok is not None else reply.err.payload  # type: ignore[union-attr]
                assert (reply.ok is None) == (kind == "error")
                heard.append((kind, payload.to_bytes()))

    with Store(path, boot, RealClock()) as store:
        for event in EVENTS:
            store.record(event)
        store.flush()
        publisher = OpenPublisher(
            Telemetry(listen=(where,), operator=(anna,)), "mill", example.NAMES, SystemClock(), boot, simulated=False,
            history=history_of(path), course=course_of(path, 300.0), stored=rows_of(path),
            report=lambda _: ReportPage("2026-01-05", "Europe/Zurich", b"\x1f\x8b\x00\xff"),
            scenario=foreseen,
        )  # fmt: skip
        async with publisher:
            await asyncio.to_thread(judge)
    assert {suffix.split("/")[0] for suffix, _ in heard} == {*MESSAGE_TYPES, *ASKED}
    for suffix, payload in heard:
        assert json.loads(encode(typed(suffix, payload))) == json.loads(payload), "nothing that its type does not have"
    published = [json.loads(payload) for _, payload in heard[: -len(ASKED)]]
    assert all(datetime.fromisoformat(message["time"]).tzinfo for message in published)
    answers = {kind: json.loads(payload) for kind, payload in heard[-len(ASKED) :]}
    assert answers["history"]["time"]
    assert answers["stored"]["tables"].keys() == set(STORED.split(","))
    assert all(
        answers["stored"]["tables"][table]["numbers"] for table in ("measurements", "steps", "events", "readings")
    )


def fields_now() -> list[str]:
    """The fields of each type: whether a reader may do without it, its place, and what it may be."""
    found = []
    for kind, schema in SCHEMAS.items():
        for name, definition in schema["$defs"].items():
            for field, form in definition["properties"].items():
                need = "required" if field in definition["required"] else "optional"
                found.append(f"{need} {kind} {name}.{field} {json.dumps(form_of(form), sort_keys=True)}")
    return sorted(found)


def form_of(form: Any) -> Any:
    """A schema without the texts that are for people."""
    match form:
        case dict():
            about = ("description", "examples", "default", "title")
            return {word: form_of(value) for word, value in form.items() if word not in about}
        case list():
            return [form_of(one) for one in form]
        case _:
            return form


def test_fields_are_only_added_and_old_messages_without_them_are_read() -> None:
    now = fields_now()
    assert [line for line in FIRST if line not in now] == [], "a reader of version 1 no longer finds them"
    new = [line for line in now if line not in FIRST]
    known = {(kind, field.partition(".")[0]) for _, kind, field, *_ in map(str.split, FIRST)}
    needed = [(kind, field.partition(".")[0]) for need, kind, field, *_ in map(str.split, new) if need == "required"]
    # A type that is new in a kind occurs only in a field that may be missing, and so does everything that it requires.
    assert [each for each in needed if each in known] == [], "a default, for what earlier gateways publish"
    assert new == [], "add these lines to fields.txt"
