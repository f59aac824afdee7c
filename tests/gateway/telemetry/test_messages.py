"""The published messages as a subscriber sees them: names, their order, values and their types."""

import json
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
import pytest

from gateway.model.events import (
    CompensationStepped,
    DecisionMade,
    EventReported,
    ForecastMade,
    FrameMade,
    GatewayEvent,
    MeasurementEnded,
    ModelsAdopted,
    OutlookChanged,
    ProbingRequested,
    ReadingsTaken,
    ReasonsGiven,
    SensorsJudged,
)
from gateway.model.probing import Outlook
from gateway.telemetry.answers import HistoryPage
from gateway.telemetry.codec import MESSAGE_TYPES, decode, decode_answer, decode_refusal, encode
from gateway.telemetry.compose import Composer, Dropped, GatewayState
from gateway.telemetry.json_schema import schemas
from gateway.telemetry.messages import DecisionMessage, Message, ProbingMessage, ProbingStanding, ReadingMessage
from talc.forecast import Forecast, Misses, PlannedForecast
from talc.frame import Decision
from talc.names import THERMAL_ERRORS
from tests.benches import telemetry_examples as example

FOLDER = Path(__file__).parent
SCHEMAS = Path(__file__).parents[3] / "docs" / "telemetry"
PUBLISHED = (FOLDER / "published.txt").read_text(encoding="utf-8").splitlines()
"""Key and payload of each example, as the first version of the key space published them: never renewed."""


class StillClock:
    """Stands still."""

    def monotonic(self) -> float:
        return example.MONOTONIC_S

    def utc(self) -> datetime:
        return example.NOW


def published() -> list[tuple[str, bytes]]:
    """The examples as they are published now."""
    composer = Composer("boot-1", example.NAMES, StillClock(), simulated=True)
    found: list[tuple[str, bytes]] = []

    def take(event: GatewayEvent) -> None:
        found.extend((key, encode(message)) for key, message in composer.messages(event))

    def status(decision: Decision, outlook: Outlook | None) -> None:
        state = GatewayState(config="the hash", decision=decision, outlook=outlook)
        key, message = composer.status(state, Dropped(0, 0), {"rtu1": 3}, {"rtu1": {7: 0.012}})
        found.append((key, encode(message)))

    take(ReadingsTaken([example.READING, example.BAD_READING]))
    take(FrameMade(example.FRAME))
    take(FrameMade(example.MEASURED_FRAME))
    for decision in (example.FIRST_DECISION, example.DECISION):
        take(DecisionMade(decision))
        status(decision, None)
    take(ProbingRequested(41))
    for outcome in (example.OUTCOME, example.PER_POSE, example.REFUSED):
        take(MeasurementEnded(outcome))
    take(ModelsAdopted(example.MODELS, 7))
    for event, k in ((example.PROBLEM, None), (example.LIMIT, 7), (example.NO_NUMBER, 7)):
        take(EventReported(event, k))
    take(CompensationStepped(example.WRITE))
    take(CompensationStepped(example.ADVICE))
    for outlook in (example.OUTLOOK, example.NO_WISH):
        take(OutlookChanged(outlook))
        status(example.DECISION, outlook)
    take(SensorsJudged(example.JUDGEMENT, 7))
    return found


def assert_kept(old: Any, new: Any) -> None:
    """The fields of the old payload in the new one: same order, values and types. Others may have been added."""
    match old:
        case dict():
            assert isinstance(new, dict)
            assert [name for name in new if name in old] == list(old)
            for name, value in old.items():
                assert_kept(value, new[name])
        case list():
            assert len(new) == len(old)
            for was, value in zip(old, new, strict=True):
                assert_kept(was, value)
        case _:
            assert repr(new) == repr(old)


def test_every_field_of_the_first_version_is_still_published_with_the_same_value() -> None:
    now = published()
    assert [key for key, _ in now] == [line.split(" ")[0] for line in PUBLISHED]
    for line, (_, payload) in zip(PUBLISHED, now, strict=True):
        assert_kept(json.loads(line.split(" ", 1)[1]), json.loads(payload))
    assert {line.split(" ")[0].split("/")[0] for line in PUBLISHED} <= set(MESSAGE_TYPES)
    assert b'"answers_s":{"rtu1":{"7":0.012}}' in dict(now)["status"], "a number as the name of a field is text"


@pytest.mark.parametrize("line", PUBLISHED)
def test_what_was_published_is_read_without_loss(line: str) -> None:
    key, payload = line.split(" ", 1)
    message = decode(key, payload.encode())
    assert message is not None
    assert_kept(json.loads(payload), json.loads(encode(message)))


def test_a_forecast_is_published_by_error_to_a_thousandth_and_stays_small() -> None:
    composer = Composer("boot-1", example.NAMES, StillClock(), simulated=True)
    ((key, message),) = composer.messages(ForecastMade(example.FORECAST, example.MISSES))
    payload = json.loads(encode(message))
    assert (key, payload["k"], payload["ahead_s"]) == ("forecast", 7, [1800.0, 28800.0])
    assert payload["stays"][THERMAL_ERRORS[0]] == {"value": [1.5, 1.5], "sigma": [1.0, 1.0]}
    assert payload["usual"][THERMAL_ERRORS[0]]["sigma"] == [0.333, 0.333]
    assert payload["measured"][THERMAL_ERRORS[0]] == [0.5, 0.5]
    assert payload["missed"][THERMAL_ERRORS[0]] == {"value": [2.0, 2.0], "sigma": [None, None]}
    assert payload["stays"][THERMAL_ERRORS[3]]["value"] == [None, None]
    assert payload["planned"] == {}
    known = PlannedForecast(example.FORECAST.value, example.FORECAST.sigma)
    ((_, message),) = composer.messages(
        ForecastMade(example.FORECAST, example.MISSES, {"warm-up": known, "never learnt": None})
    )
    assert json.loads(encode(message))["planned"] == {"warm-up": payload["stays"], "never learnt": {}}
    steps = tuple(range(1, 8))
    widest = np.full((7, 9), -1234.5678)
    whole = Forecast(7, steps, (28800.0,) * 7, widest, widest, widest, widest, widest)
    ((_, message),) = composer.messages(ForecastMade(whole, Misses(widest, widest)))
    assert len(encode(message)) < 8000


def test_reasons_are_published_by_error_and_what_is_not_known_is_null() -> None:
    composer = Composer("boot-1", example.NAMES, StillClock(), simulated=True)
    ((key, message),) = composer.messages(ReasonsGiven(example.REASONS))
    payload = json.loads(encode(message))
    assert (key, payload["k"], payload["next_k"], payload["next_why"]) == ("reasons", 7, 19, "uncertainty")
    assert list(payload["errors"]["EY0A"]["inputs"].items()) == [("bed_front", 4.0), ("Öl", -1.0)]
    assert payload["errors"]["EX0C"]["expected"] is None
    assert decode(key, encode(message)) == message


def test_a_decision_says_which_errors_are_corrected_and_one_of_an_earlier_program_is_read_without() -> None:
    composer = Composer("boot-1", example.NAMES, StillClock(), simulated=True)
    half = replace(example.DECISION, trusted=np.array([True] * 8 + [False]))
    ((key, message),) = composer.messages(DecisionMade(half))
    payload = json.loads(encode(message))
    assert payload["trusted"] == {name: name != "EC0C" for name in THERMAL_ERRORS}
    del payload["trusted"]
    old = decode(key, json.dumps(payload).encode())
    assert isinstance(old, DecisionMessage)
    assert old.trusted == {}


def with_field(payload: dict[str, Any]) -> dict[str, Any]:
    return payload | {"of_the_future": {"unknown": 1}, "quality": "of_the_future"}


def test_a_reader_passes_over_keys_and_fields_and_texts_of_later_versions() -> None:
    key, payload = PUBLISHED[0].split(" ", 1)
    message = decode(key, json.dumps(with_field(json.loads(payload))).encode())
    assert isinstance(message, ReadingMessage)
    assert (message.value, message.quality) == (20.0, "of_the_future")
    assert decode("of_the_future/x", b"anything") is None


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda p: {**p, "value": "warm"}, r"reading/bed_front: Expected `float \| null`, got `str` - at `\$.value`"),
        (lambda p: {k: v for k, v in p.items() if k != "unit"}, "missing required field `unit`"),
        (lambda p: [p], "Expected `object`"),
    ],
)
def test_a_payload_that_is_invalid_is_an_error_with_key_and_field(change: Callable[[Any], Any], said: str) -> None:
    key, payload = PUBLISHED[0].split(" ", 1)
    with pytest.raises(ValueError, match=said):
        decode(key, json.dumps(change(json.loads(payload))).encode())


def test_the_committed_schemas_are_those_of_the_types() -> None:
    committed = {path.name.split(".")[0]: path.read_text(encoding="utf-8") for path in SCHEMAS.glob("*.schema.json")}
    assert committed == schemas(), "renew them: python -m gateway.telemetry docs/telemetry"


@pytest.mark.parametrize("deep", [b"[" * 100_000, b"[" * 100_000 + b"]" * 100_000])
def test_brackets_within_brackets_in_an_unknown_field_are_an_invalid_payload(deep: bytes) -> None:
    event = next(line.partition(" ")[2] for line in PUBLISHED if line.startswith("event"))
    with pytest.raises(ValueError, match="payload of event: "):
        decode("event", event.encode()[:-1] + b',"unknown":' + deep + b"}")
    with pytest.raises(ValueError, match="HistoryPage: "):
        decode_answer(HistoryPage, b'{"unknown":' + deep + b"}")
    assert decode_refusal(b'{"unknown":' + deep).startswith('{"unknown":[[[')


def test_the_message_and_the_status_say_the_same_of_a_wanted_measurement() -> None:
    """msgspec lets no class have the fields of two others, so both list them."""
    stamp = get_type_hints(Message)
    own = {name: hint for name, hint in get_type_hints(ProbingMessage).items() if name not in stamp}
    assert list(own.items()) == list(get_type_hints(ProbingStanding).items())
