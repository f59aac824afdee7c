"""docs/keys.md matches what is published, field by field, and what is answered."""

import math
import re
from enum import StrEnum
from pathlib import Path

import numpy as np
import pytest

from gateway.config.applied import ConfigurationApplied
from gateway.model.compensation import Source, Step, Write
from gateway.model.control_state import NcState
from gateway.model.events import (
    CompensationStepped,
    DecisionMade,
    EventReported,
    ForecastMade,
    FrameMade,
    Health,
    HealthChecked,
    MeasurementEnded,
    ModelsAdopted,
    OutlookChanged,
    ReadingsTaken,
    ReasonsGiven,
    SensorsJudged,
    StorageChanged,
    StoreHealth,
)
from gateway.model.probing import Outcome, Outlook
from gateway.model.standing import Standing
from gateway.model.text import plain
from gateway.telemetry import keys
from gateway.telemetry.codec import MESSAGE_TYPES
from gateway.telemetry.json_schema import schemas
from talc.frame import Event, EventKind, Frame, Measurement, Why
from talc.sensor_check import Judgement
from tests.benches import telemetry_examples as example
from tests.benches.control_models import models
from tests.benches.free_port import free_port
from tests.benches.telemetry_examples import configuration
from tests.benches.telemetry_peer import NOW, ROOT, decision, last_values, reading, telemetry

PAGE = (Path(__file__).parents[3] / "docs" / "keys.md").read_text(encoding="utf-8")


def table() -> dict[str, set[str]]:
    """Kind of key to the fields that its row names in backticks."""
    rows = re.findall(r"^\| `(\w+)[^`]*` \| (.*) \|$", PAGE, re.MULTILINE)
    return {kind: set(re.findall(r"`(\w+)`", payload)) for kind, payload in rows}


@pytest.mark.parametrize(
    ("before", "words"),
    [
        ("`standing` of a wanted measurement: ", Standing),
        ("the control (`nc`: ", NcState),
    ],
)
def test_the_table_has_every_word_of_a_field(before: str, words: type[StrEnum]) -> None:
    listed = PAGE.partition(before)[2]
    assert listed[: min(listed.index(end) for end in ";)")].split(", ") == [str(word) for word in words]


def test_the_page_lists_and_counts_the_keys_that_only_answer_queries() -> None:
    number, listed = re.findall(r"answers queries on (\w+) more keys\..*?\n\n((?:[- ] [^\n]*\n)+)", PAGE, re.DOTALL)[0]
    parts = {"command_terms", "command_request", "error"}
    answered = schemas().keys() - MESSAGE_TYPES.keys() - parts | {keys.SCHEMA}
    assert sorted(re.findall(r"^- `(\w+)", listed, re.MULTILINE)) == sorted(answered)
    assert number == ("four", "five", "six", "seven", "eight")[len(answered) - 4]


async def test_the_table_has_every_key_and_every_field_that_is_published() -> None:
    port, step = free_port(), Step((0.0, 0.0, 9.0), (0.0, 0.0, 3.0), Source.PREDICTION, (False, False, False))
    measured = Measurement(np.zeros(9), np.ones(9))
    async with telemetry(port, periods_missed=lambda: {"rtu1": 3}) as t:
        t.publish(ConfigurationApplied(configuration("mill")))
        t.publish(ReadingsTaken([reading(20.0)]))
        t.publish(FrameMade(Frame(7, np.array([20.5, math.nan]), np.array([True, False]))))
        t.publish(DecisionMade(decision(7)))
        t.publish(
            MeasurementEnded(Outcome(1, Why.CALIBRATION, NOW, NOW, np.zeros((6, 3)), (0.0, 0.0, 0.0), measured, 0.4))
        )
        t.publish(ModelsAdopted(models(7), 7))
        t.publish(CompensationStepped(Write(NOW, "advise", step, 7, {"X": 1.0}, False, None)))
        t.publish(SensorsJudged(Judgement(), 7))
        t.publish(ReasonsGiven(example.REASONS))
        t.publish(ForecastMade(example.FORECAST, example.MISSES))
        t.publish(OutlookChanged(Outlook(Standing.DUE, Why.INTERVAL, plain(""), 0, plain(""))))
        t.publish(StorageChanged(StoreHealth(plain("database is locked"), 5.0, 40, 0, 900.0)))
        t.publish(HealthChecked(Health(60.0, 30, 29, NcState.READY, True, (), StoreHealth())))
        t.publish(EventReported(Event(EventKind.PROBLEM, "the last"), 7))
        found = last_values(port)
    common = {"boot", "seq", "time", "clock"}
    assert all(common <= payload.keys() for payload in found.values())
    assert all(f"`{name}`" in PAGE.split("|")[0] for name in common)
    published = {key.removeprefix(f"{ROOT}/").split("/")[0]: payload.keys() - common for key, payload in found.items()}
    assert table() == published | {keys.ALIVE: set()}
