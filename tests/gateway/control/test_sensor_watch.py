"""The sensor watch on days of a plant: what it reports and when, what it learns from, and what a restart keeps."""

import asyncio
import logging
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rich.console import Console

from gateway.control.sensor_watch import SeenBefore, SensorWatch
from gateway.listeners.watch.view import ViewState, render
from gateway.model.events import EventReported, GatewayEvent, SensorsJudged
from gateway.runtime.workers.process import WorkError
from gateway.telemetry.codec import decode, encode
from gateway.telemetry.compose import Composer
from gateway.telemetry.messages import SensorsMessage
from talc.frame import EventKind, FloatArray, Frame, Frames
from talc.sensor_check import Judgement
from talc.sensor_model import SensorModel, learn
from talc.settings import SensorCheckSettings
from tests.benches import hot_bearing
from tests.benches.plant_days import DAY, NAMES, plant_days
from tests.benches.sensor_teacher import SensorTeacher
from tests.benches.stepped_clock import SteppedClock

SETTINGS = SensorCheckSettings()
INPUTS = (*NAMES, "coolant")
SWAPPED = ("a_drive", "bed_front_left")
K0 = 12_000
"""A multiple of an hour: when it judges depends on k alone."""


class Ear:
    def __init__(self) -> None:
        self.events: list[tuple[EventKind, str, int | None]] = []
        self.judgements: list[tuple[Judgement, int]] = []
        self.since: list[tuple[int, ...]] = []

    def __call__(self, event: GatewayEvent) -> None:
        match event:
            case EventReported(reported, k):
                self.events.append((reported.kind, reported.text, k))
            case SensorsJudged(judgement, k, since):
                self.judgements.append((judgement, k))
                self.since.append(since)
            case _:
                raise AssertionError(event)


def days(seed: int = 12) -> NDArray[np.float64]:
    temperatures = plant_days(seed)
    return np.column_stack([temperatures, np.zeros(len(temperatures))])


def exchanged(x: NDArray[np.float64]) -> NDArray[np.float64]:
    i, j = (NAMES.index(name) for name in SWAPPED)
    y = x.copy()
    y[:, [i, j]] = y[:, [j, i]]
    return y


def before(inputs: FloatArray, since: int | None = None) -> SeenBefore:
    frames = Frames(np.arange(K0, K0 + len(inputs)), inputs, np.ones(inputs.shape, np.bool_), np.empty((0, 9)))
    return SeenBefore(frames, since)


def watch(ear: Ear, teacher: SensorTeacher, before: SeenBefore | None = None) -> SensorWatch:
    return SensorWatch(INPUTS, SETTINGS, 300.0, NAMES.__contains__, ear, SteppedClock(), before, teacher)


async def run(watching: SensorWatch, x: NDArray[np.float64], first_k: int) -> None:
    for k, row in enumerate(x, first_k):
        watching.follow(Frame(k, row, np.ones(len(INPUTS), np.bool_)))
        if k % 12 == 0:
            await watching.look()


@pytest.mark.slow
async def test_an_exchange_is_reported_once_and_so_is_its_end(caplog: pytest.LogCaptureFixture) -> None:
    ear, teacher, x = Ear(), SensorTeacher(), days()
    watching = watch(ear, teacher)
    await run(watching, x[: 3 * DAY], K0)
    assert ear.events == []
    assert len(teacher.rows) == 2
    with caplog.at_level(logging.WARNING, logger="gateway.control.sensor_watch"):
        await run(watching, exchanged(x[3 * DAY : 4 * DAY]), K0 + 3 * DAY)
    assert [kind for kind, _, _ in ear.events] == [EventKind.SENSOR_SUSPECT]
    assert all(name in ear.events[0][1] for name in SWAPPED)
    assert [r.getMessage() for r in caplog.records] == [f"sensors: {ear.events[0][1]}"]
    assert any(set(f.inputs) == set(SWAPPED) for f in ear.judgements[-1][0].findings)
    told_k = ear.events[0][2]
    assert told_k is not None
    swaps = [
        (k, since)
        for (judged, k), since_k in zip(ear.judgements, ear.since, strict=True)
        for finding, since in zip(judged.findings, since_k, strict=True)
        if finding.kind == "swap"
    ]
    assert {since for _, since in swaps} == {swaps[0][0]}, "since the first judgement that found it"
    assert swaps[0][0] < told_k
    assert told_k - (K0 + 3 * DAY) <= 1.5 * SETTINGS.window_steps
    assert len(teacher.rows) == 3
    assert teacher.rows[-1] < 3 * DAY, "learnt from what was suspect"
    caplog.clear()
    with caplog.at_level(logging.DEBUG, logger="gateway.control.sensor_watch"):
        await run(watching, x[4 * DAY :], K0 + 4 * DAY)
    assert [kind for kind, _, _ in ear.events] == [EventKind.SENSOR_SUSPECT, EventKind.SENSORS_AGREE]
    assert caplog.records[-1].levelno == logging.WARNING, "the end at the level at which the exchange was reported"
    assert ear.judgements[-1][0].findings == ()


async def test_a_finding_is_published_and_shown() -> None:
    ear, x = Ear(), exchanged(days())
    seen = before(days()[: 2 * DAY])
    await run(watch(ear, SensorTeacher(), seen), x[2 * DAY : 2 * DAY + 150], K0 + 2 * DAY)
    judgement, k = ear.judgements[-1]
    composer = Composer("boot", INPUTS, SteppedClock(), simulated=False)
    ((key, message),) = composer.messages(SensorsJudged(judgement, k, ear.since[-1]))
    received = decode(key, encode(message))
    assert isinstance(received, SensorsMessage)
    finding = received.findings[0]
    assert (finding.kind, set(finding.inputs), finding.offset_K) == ("swap", set(SWAPPED), None)
    assert finding.since_k == ear.since[-1][0] < k
    assert set(received.smallest_offset_K) == set(NAMES)
    state = ViewState("mill")
    state.apply(received)
    with (console := Console(width=100)).capture() as shown:
        console.print(render(state))
    assert f"sensors: {finding.text}" in shown.get()


async def test_nothing_is_learnt_from_a_window_that_is_not_judged_yet() -> None:
    teacher, x = SensorTeacher(), days()
    await run(watch(Ear(), teacher), x[: 3 * DAY], K0)
    assert set(teacher.names) == {NAMES}, "only temperatures"
    assert teacher.rows[0] <= DAY + 12
    assert teacher.rows[1] <= 2 * DAY + 12 - SETTINGS.window_steps


async def test_a_restart_finds_the_fault_again_and_does_not_learn_it() -> None:
    ear, teacher, x = Ear(), SensorTeacher(), days()
    faulty = np.concatenate([x[: 3 * DAY], exchanged(x[3 * DAY : 4 * DAY])])
    since = K0 + 3 * DAY + 120
    earlier = before(faulty, since)
    await run(watch(ear, teacher, earlier), exchanged(x[4 * DAY : 4 * DAY + 80]), K0 + 4 * DAY)
    assert teacher.names == [NAMES], "only temperatures"
    assert len(teacher.rows) == 1
    assert teacher.rows[0] < 3 * DAY
    assert [kind for kind, _, _ in ear.events] == [EventKind.SENSOR_SUSPECT]
    assert all(name in ear.events[0][1] for name in SWAPPED)


async def test_a_weekend_at_rest_ends_no_finding() -> None:
    ear, x = Ear(), days()
    faulty = exchanged(x[3 * DAY : 4 * DAY])
    rest = np.tile(faulty[-1], (2 * DAY, 1))
    watching = watch(ear, SensorTeacher())
    await run(watching, np.concatenate([x[: 3 * DAY], faulty, rest]), K0)
    assert [kind for kind, _, _ in ear.events] == [EventKind.SENSOR_SUSPECT]
    assert ear.judgements[-1][0] == Judgement()


async def test_a_gap_is_not_a_window() -> None:
    ear, teacher, x = Ear(), SensorTeacher(), days()
    watching = watch(ear, teacher)
    await run(watching, x[: 2 * DAY], K0)
    known = len(ear.judgements)
    await run(watching, x[2 * DAY : 2 * DAY + 13], K0 + 2 * DAY + 600)
    assert all(j.smallest_offset_K == {} for j, _ in ear.judgements[known:])
    assert ear.events == []


@pytest.mark.parametrize(
    ("error", "said"),
    [(WorkError("out of memory"), "out of memory"), (ValueError("no rows"), "unexpected ValueError: no rows")],
)
async def test_a_learning_that_fails_is_reported_once_and_tried_each_hour(
    caplog: pytest.LogCaptureFixture, error: Exception, said: str
) -> None:
    errors = [error] * 3

    def learning(*given: Any) -> SensorModel | None:
        if errors:
            raise errors.pop()
        return learn(*given)

    ear, teacher = Ear(), SensorTeacher(learning)
    with caplog.at_level(logging.WARNING, logger="gateway.control.sensor_watch"):
        await run(watch(ear, teacher), days()[: DAY + 48], K0)
    text = "their model could not be learnt"
    assert len(teacher.rows) == 4
    assert [r.getMessage() for r in caplog.records] == [f"sensors: {text}: {said}", f"sensors, resolved: {text}"]
    assert [(kind, t) for kind, t, _ in ear.events] == [
        (EventKind.PROBLEM, f"sensors: {text}: {said}"),
        (EventKind.PROBLEM_ENDED, f"sensors, resolved: {text}"),
    ]


async def test_a_judgement_that_raises_ends_nothing_and_is_reported_once(caplog: pytest.LogCaptureFixture) -> None:
    """A model with the statistics of too few sensors: no caller expects the error that the thread raises."""

    def wrong(*given: Any) -> SensorModel | None:
        model = learn(*given)
        return model and replace(model, offset_std=model.offset_std[:3])

    ear, teacher, x = Ear(), SensorTeacher(wrong), days()
    with caplog.at_level(logging.WARNING, logger="gateway.control.sensor_watch"):
        await run(watch(ear, teacher), x[: 2 * DAY + 240], K0)
    assert len(teacher.rows) == 2, "learning goes on"
    assert not any(judgement.smallest_offset_K for judgement, _ in ear.judgements)
    (record,) = caplog.records
    assert record.exc_info is not None
    assert record.getMessage().startswith("sensors: not judged: unexpected ")
    assert [(kind, text) for kind, text, _ in ear.events] == [(EventKind.PROBLEM, record.getMessage())]


async def test_runs_by_itself_and_learns_in_another_process() -> None:
    ear, x = Ear(), days()
    seen = before(x[: 2 * DAY])
    watching = SensorWatch(INPUTS, SETTINGS, 300.0, NAMES.__contains__, ear, SteppedClock(), seen)
    task = asyncio.create_task(watching.run())
    try:
        async with asyncio.timeout(300):
            k = K0 + 2 * DAY
            # However long it learns: it then judges the present window, and that of an idle machine shows nothing.
            while not any(judgement.smallest_offset_K for judgement, _ in ear.judgements):
                watching.follow(Frame(k, x[(k - K0) % len(x)], np.ones(len(INPUTS), np.bool_)))
                k += 1
                await asyncio.sleep(0.05)
    finally:
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
    assert len(ear.judgements[-1][0].smallest_offset_K) == len(NAMES)


@pytest.mark.slow
async def test_a_bearing_that_runs_hot_is_reported_where_the_speed_is_known() -> None:
    speed, friction = hot_bearing.work(0, 10), np.ones(10 * hot_bearing.DAY)
    friction[8 * hot_bearing.DAY :] = 1.6
    x, told = hot_bearing.bodies(speed, 0, friction), dict[bool, list[str]]()
    for known in (True, False):

        def is_load(name: str, known: bool = known) -> bool:
            return known and name == "spindle_speed"

        async def learn_here(*given: object) -> SensorModel | None:
            return learn(*given)  # type: ignore[arg-type]

        ear = Ear()
        watching = SensorWatch(
            hot_bearing.NAMES,
            SETTINGS,
            300.0,
            hot_bearing.BODIES.__contains__,
            ear,
            SteppedClock(),
            None,
            learn_here,
            is_load=is_load,
        )
        for k, row in enumerate(x, K0):
            watching.follow(Frame(k, row, np.ones(len(row), np.bool_)))
            if k % 12 == 0:
                await watching.look()
        told[known] = [text for kind, text, _ in ear.events if kind == EventKind.SENSOR_SUSPECT]
        assert ear.judgements[-1][0].loads == (("spindle_speed",) if known else ())
    assert told[False] == []
    assert len(told[True]) == 1
    assert told[True][0].startswith("bearing is off by +")
