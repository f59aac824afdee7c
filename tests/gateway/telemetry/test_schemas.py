"""What leaves a gateway fits the schemas of docs/telemetry: heard with only Zenoh, checked by `schema_faults`."""

import asyncio
import base64
import json
import math
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

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
from gateway.telemetry.codec import MESSAGE_TYPES
from gateway.telemetry.messages import PublishedCourse
from gateway.telemetry.scenario_queries import ScenarioRequest
from tests.benches import telemetry_examples as example
from tests.benches.free_port import free_port
from tests.benches.open_publisher import OpenPublisher
from tests.benches.telemetry_examples import configuration
from tests.benches.telemetry_peer import ROOT, reading
from tests.benches.zenoh_sessions import client

# Checks JSON against a JSON Schema, without the types and the library that make the schemas of the key space.
#
# Knows the keywords that docs/telemetry uses; another one is an error, not passed over.


_TYPES: dict[str, tuple[type, ...]] = {
    "null": (type(None),),
    "boolean": (bool,),
    "integer": (int,),
    "number": (int, float),
    "string": (str,),
    "array": (list,),
    "object": (dict,),
}
_SILENT = {"title", "description", "default", "examples", "$schema", "$defs", "prefixItems", "required"}
"""Say nothing about a value, or are looked at with another keyword."""


def schema_faults(value: Any, schema: dict[str, Any], at: str = "$", whole: dict[str, Any] | None = None) -> list[str]:
    """What in a value contradicts the schema, each with its place; empty: it fits."""
    whole = schema if whole is None else whole
    found: list[str] = []
    for word, wanted in schema.items():
        match word:
            case "$ref":
                found += schema_faults(value, whole["$defs"][wanted.rpartition("/")[2]], at, whole)
            case "anyOf":
                if all(schema_faults(value, one, at, whole) for one in wanted):
                    found.append(f"{at}: {value!r} is none of {wanted}")
            case "type":
                of_type = isinstance(value, _TYPES[wanted]) and (wanted == "boolean" or not isinstance(value, bool))
                found += [] if of_type else [f"{at}: {value!r} is no {wanted}"]
            case _ if word in _SILENT:
                pass
            case _:
                found += _faults_of(word, value, schema, at, whole)
    return found


def _faults_of(word: str, value: Any, schema: dict[str, Any], at: str, whole: dict[str, Any]) -> list[str]:
    wanted = schema[word]
    match word, value:
        case "properties", dict():
            missing = [f"{at}: {name} is missing" for name in schema.get("required", ()) if name not in value]
            inside = [schema_faults(value[n], s, f"{at}.{n}", whole) for n, s in wanted.items() if n in value]
            return [*missing, *(fault for faults in inside for fault in faults)]
        case "additionalProperties", dict() if isinstance(wanted, dict):
            others = [name for name in value if name not in schema.get("properties", ())]
            return [f for name in others for f in schema_faults(value[name], wanted, f"{at}.{name}", whole)]
        case "items", list():
            first = schema.get("prefixItems", ())
            kinds = [*first, *[wanted] * (len(value) - len(first))] if isinstance(wanted, dict) else first
            each = zip(value, kinds, strict=False)
            return [f for n, (one, kind) in enumerate(each) for f in schema_faults(one, kind, f"{at}[{n}]", whole)]
        case ("minItems", list()) | ("minLength", str()):
            return [] if len(value) >= wanted else [f"{at}: has {len(value)}, at least {wanted} are expected"]
        case ("maxItems", list()) | ("maxLength", str()):
            return [] if len(value) <= wanted else [f"{at}: has {len(value)}, at most {wanted} are expected"]
        case "minimum", int() | float():
            return [] if value >= wanted else [f"{at}: {value} is less than {wanted}"]
        case (("format" | "contentEncoding"), str()):
            return [] if _READERS[wanted](value) else [f"{at}: {value!r} is no {wanted}"]
        case (
            ("properties" | "additionalProperties" | "items" | "minItems" | "maxItems" | "minLength" | "maxLength"),
            _,
        ):
            return []
        case (("minimum" | "format" | "contentEncoding"), _):
            return []
    raise ValueError(f"{at}: {word}: a keyword that is not known here")


def _is_time(text: str) -> bool:
    try:
        return datetime.fromisoformat(text).tzinfo is not None
    except ValueError:
        return False


def _is_base64(text: str) -> bool:
    try:
        return bool(base64.b64decode(text, validate=True))
    except ValueError:
        return False


_READERS = {"date-time": _is_time, "base64": _is_base64}


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


async def test_every_message_and_every_answer_fits_its_schema(tmp_path: Path) -> None:
    key, path, boot = tmp_path / "anna.key", tmp_path / "gateway.sqlite", boot_id()
    key.write_text("anna" * 10, encoding="utf-8")
    anna = Operator(name="anna", key_file=key, may=(CommandName.PAUSE,))
    where = f"tcp/127.0.0.1:{free_port()}"
    heard: list[tuple[str, Any]] = []

    def judge() -> None:
        with client(int(where.rpartition(":")[2])) as session:

            def take(sample: Any) -> None:
                heard.append((str(sample.key_expr).removeprefix(f"{ROOT}/"), json.loads(sample.payload.to_bytes())))

            subscriber = session.declare_subscriber(f"{ROOT}/**", take)
            list(session.get(f"{ROOT}/**", timeout=LIMIT_S))  # the subscription has arrived
            for event in EVENTS:
                publisher.publish(event)
            while not heard or heard[-1][0] != "event" or heard[-1][1]["text"] != example.NO_NUMBER.text:
                list(session.get(f"{ROOT}/status", timeout=LIMIT_S))
            subscriber.undeclare()
            for kind, selector in ASKED.items():
                (reply,) = session.get(f"{ROOT}/{selector}", timeout=LIMIT_S)
                payload = reply.ok.payload if reply.ok is not None else reply.err.payload  # type: ignore[union-attr]
                assert (reply.ok is None) == (kind == "error")
                heard.append((kind, json.loads(payload.to_bytes())))

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
    faults = [
        f"{suffix}: {fault}"
        for suffix, payload in heard
        for fault in schema_faults(payload, SCHEMAS[suffix.split("/")[0]])
    ]
    assert faults == []
    answers = dict(heard[-len(ASKED) :])
    assert answers["history"]["time"]
    assert answers["stored"]["tables"].keys() == set(STORED.split(","))
    assert all(
        answers["stored"]["tables"][table]["numbers"] for table in ("measurements", "steps", "events", "readings")
    )


@pytest.mark.parametrize(
    ("kind", "change", "said"),
    [
        ("reading", {"value": "warm"}, "$.value: 'warm' is none of"),
        ("reading", {"time": "2026-01-05T06:00:00"}, "$.time: '2026-01-05T06:00:00' is no date-time"),
        ("reading", {"seq": 1.5}, "$.seq: 1.5 is no integer"),
        ("reading", {"seq": True}, "$.seq: True is no integer"),
        ("decision", {"predicted": {"EY0A": "much"}}, "$.predicted.EY0A: 'much' is none of"),
        ("decision", {"substituted": ["bed", 1]}, "$.substituted[1]: 1 is no string"),
        ("compensation", {"target_um": [0.0, 0.0]}, "$.target_um: has 2, at least 3 are expected"),
        ("compensation", {"target_um": [0.0] * 4}, "$.target_um: has 4, at most 3 are expected"),
        ("compensation", {"target_um": [0.0, "far", 0.0]}, "$.target_um[1]: 'far' is no number"),
    ],
)
def test_a_payload_that_does_not_fit_is_found(kind: str, change: dict[str, Any], said: str) -> None:
    lines = (Path(__file__).parent / "published.txt").read_text(encoding="utf-8").splitlines()
    payload = json.loads(next(line.split(" ", 1)[1] for line in lines if line.startswith(kind)))
    assert schema_faults(payload, SCHEMAS[kind]) == []
    (found,) = schema_faults(payload | change, SCHEMAS[kind])
    assert found.startswith(said)
    for name in payload:
        rest = {other: value for other, value in payload.items() if other != name}
        required = SCHEMAS[kind]["$defs"][SCHEMAS[kind]["$ref"].rpartition("/")[2]]["required"]
        assert schema_faults(rest, SCHEMAS[kind]) == ([f"$: {name} is missing"] if name in required else [])


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
