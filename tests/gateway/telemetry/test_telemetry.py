"""Telemetry over real Zenoh sessions on loopback."""

import asyncio
import json
import math
import socket
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
import zenoh

from drivers.base import Quality
from gateway.config.applied import ConfigurationApplied
from gateway.config.file import parse
from gateway.config.model import GatewayConfig
from gateway.listeners.watch.view import ViewState, feeding, render
from gateway.model.codes import NoticeCode
from gateway.model.compensation import Source, Step, Write
from gateway.model.events import (
    CompensationStepped,
    DecisionMade,
    EventReported,
    FrameMade,
    OutlookChanged,
    ReadingsTaken,
)
from gateway.model.probing import Outlook
from gateway.model.sample import Sample
from gateway.model.standing import Standing
from gateway.model.text import plain
from talc.frame import Event, EventKind, Frame, Why
from tests.benches.free_port import free_port
from tests.benches.service_file import adam6015
from tests.benches.stepped_clock import SteppedClock
from tests.benches.telemetry_examples import configuration
from tests.benches.telemetry_peer import NAMES, NOW, decision, last_values, problem, reading, telemetry
from tests.benches.waits import until
from tests.benches.zenoh_sessions import client


class SampleInbox:
    """Collects samples until enough have come."""

    def __init__(self, wanted: int) -> None:
        self.samples: list[tuple[str, Any]] = []
        self._wanted, self._full = wanted, threading.Event()

    def __call__(self, sample: zenoh.Sample) -> None:
        self.samples.append((str(sample.key_expr), json.loads(sample.payload.to_bytes())))
        if len(self.samples) >= self._wanted:
            self._full.set()

    def wait(self) -> list[tuple[str, Any]]:
        assert self._full.wait(60.0), f"only {len(self.samples)} of {self._wanted} came"
        return self.samples


async def test_every_frame_arrives_in_order_with_null_for_what_is_missing() -> None:
    port, inbox = free_port(), SampleInbox(50)
    async with telemetry(port) as t:
        with client(port) as session:
            subscriber = session.declare_subscriber("talc/mill/frame", inbox)
            # A query makes sure the subscription has reached the gateway before the first put.
            list(session.get("talc/mill/**", timeout=60.0))
            for k in range(50):
                t.publish(FrameMade(Frame(k, np.array([20.5, math.nan]), np.array([True, False]))))
            samples = inbox.wait()
            subscriber.undeclare()
    assert [p["k"] for _, p in samples] == list(range(50))
    assert samples[0][1]["inputs"] == {"t0": 20.5, "t1": None}
    assert {p["boot"] for _, p in samples} == {"boot-1"}
    sequence = [p["seq"] for _, p in samples]
    assert sequence == sorted(set(sequence))


async def test_a_late_subscriber_gets_the_last_value_of_every_key() -> None:
    port = free_port()
    async with telemetry(port) as t:
        t.publish(ReadingsTaken([reading(20.0)]))
        t.publish(ReadingsTaken([reading(math.nan, Quality.COMM_FAULT)]))
        t.publish(ConfigurationApplied(configuration("first")))
        t.publish(DecisionMade(decision(7)))
        t.publish(ConfigurationApplied(second := configuration("second")))
        t.publish(EventReported(Event(EventKind.PROBLEM, "device rtd1: silent"), 7))
        found = last_values(port)
    assert found["talc/mill/reading/t0"]["value"] is None
    assert found["talc/mill/reading/t0"]["quality"] == "comm_fault"
    status = found["talc/mill/status"]
    assert (status["config"], status["phase"], status["k"]) == (second.fingerprint(), "calibration", 7)
    assert found["talc/mill/decision"]["predicted"]["EZ0A"] == 1.0
    assert found["talc/mill/decision"]["limits"]["EZ0A"] is None


def _with_planned_loads(folder: Path, *names: str) -> GatewayConfig:
    (folder / "talc.key").write_text("k" * 64, encoding="utf-8")
    control = '[nc]\nkind = "linuxcnc"\nhost = "127.0.0.1"\nport = 7700\nkey_file = "talc.key"\n'
    planned = [f'[[planned_load]]\nname = "{name}"\nloads = {{spindle_speed = 6000.0}}\n' for name in names]
    machine = '[machine]\nname = "mill"\n' + adam6015("bed = 0") + '[[state]]\nname = "spindle_speed"\n'
    return parse(machine + "".join(planned) + control, folder / "gateway.toml")


async def test_the_status_names_the_planned_loads_of_the_configuration_in_use(tmp_path: Path) -> None:
    port = free_port()
    async with telemetry(port) as t:
        t.publish(ConfigurationApplied(_with_planned_loads(tmp_path, "warm-up", "roughing")))
        t.publish(EventReported(Event(EventKind.PROBLEM, "after it"), 7))
        before = last_values(port)["talc/mill/status"]["planned_loads"]
        t.publish(ConfigurationApplied(_with_planned_loads(tmp_path, "roughing")))
        t.publish(EventReported(Event(EventKind.PROBLEM, "after that"), 8))
        after = last_values(port, "after that")["talc/mill/status"]["planned_loads"]
    assert (before, after) == (["warm-up", "roughing"], ["roughing"])


async def test_the_status_has_the_chain_of_the_machine() -> None:
    port = free_port()
    mill = configuration("mill")
    machine = mill.machine.model_copy(update={"chain": "w-X'-Y'-b-Z-S-t"})
    async with telemetry(port) as t:
        t.publish(ConfigurationApplied(mill.model_copy(update={"machine": machine})))
        t.publish(EventReported(Event(EventKind.PROBLEM, "after it"), 7))
        assert last_values(port)["talc/mill/status"]["kinematics"] == "w-X'-Y'-b-Z-S-t"


async def test_a_reading_is_published_with_its_age_whatever_its_time_of_day() -> None:
    port, clock = free_port(), SteppedClock()
    clock.spend(10.0)
    async with telemetry(port, clock) as t:
        t.publish(ReadingsTaken([reading(20.0), Sample("t1", 20.0, "degC", Quality.GOOD, NOW, 7.5, sequence=2)]))
        t.publish(EventReported(Event(EventKind.PROBLEM, "after it"), 7))
        found = last_values(port)
    assert found["talc/mill/reading/t0"]["age_s"] == 10.0
    assert found["talc/mill/reading/t1"]["age_s"] == 2.5


async def test_the_token_exists_as_long_as_the_gateway_runs() -> None:
    port, there, gone = free_port(), threading.Event(), threading.Event()
    async with telemetry(port):
        session = client(port)
        assert [str(r.ok.key_expr) for r in session.liveliness().get("talc/mill/alive", timeout=60.0) if r.ok] == [
            "talc/mill/alive"
        ]
        watcher = session.liveliness().declare_subscriber(
            "talc/mill/alive",
            lambda s: (gone if s.kind == zenoh.SampleKind.DELETE else there).set(),
            history=True,
        )
        # Before the gateway has heard of the watcher it would tell nobody of its end.
        assert await asyncio.to_thread(there.wait, 60.0)
    assert gone.wait(60.0)
    watcher.undeclare()
    session.close()


async def test_a_port_in_use_is_named_and_holds_up_nothing() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        async with telemetry(port) as gateway:
            problem = gateway.reached.connection().problem
    assert problem.says(NoticeCode.TELEMETRY_NOT_OPEN)
    assert problem.value_of("places") == f"tcp/127.0.0.1:{port}"


def test_the_view_fits_eighty_columns_and_shows_what_came() -> None:
    from rich.console import Console

    state = ViewState("mill", progress_until_s=3600.0)
    take = feeding(state, NAMES, SteppedClock(), simulated=True)
    take(DecisionMade(decision(7)))
    take(ReadingsTaken([reading(20.0, Quality.SENSOR_FAULT)]))
    take(EventReported(Event(EventKind.PROBLEM, "channel t0: sensor_fault"), None))
    console = Console(width=80, record=True, force_terminal=False, file=open("/dev/null", "w"))  # noqa: SIM115, PTH123
    with console.file:
        console.print(render(state))
    text = console.export_text()
    assert all(len(line) <= 80 for line in text.splitlines())
    for wanted in ("calibration", "0 of 1 good", "t0 sensor fault", "EC0C", "µm/m", "8.0", "channel t0: sensor_fault"):
        assert wanted in text, wanted


@pytest.mark.parametrize(("mode", "published"), [("monitor", False), ("advise", True), ("compensate", True)])
async def test_offsets_are_published_in_every_mode_but_monitor(
    mode: Literal["monitor", "advise", "compensate"], published: bool
) -> None:
    port = free_port()
    step = Step((0.0, 0.0, 9.0), (0.0, 0.0, 3.0), Source.PREDICTION, (False, False, False))
    async with telemetry(port) as t:
        t.publish(CompensationStepped(Write(NOW, mode, step, 7, {"X": 1.0}, False, None)))
        t.publish(EventReported(Event(EventKind.PROBLEM, "after it"), 7))
        found = last_values(port)
    assert ("talc/mill/compensation" in found) is published
    if published:
        assert found["talc/mill/compensation"]["offsets_um"] == [0.0, 0.0, 3.0]


async def test_where_probing_stands_is_in_its_own_key_and_in_the_status() -> None:
    port = free_port()
    async with telemetry(port) as t:
        t.publish(
            OutlookChanged(Outlook(Standing.BLOCKED, Why.INTERVAL, plain("alarm 21612"), 2, plain("clean the sphere")))
        )
        t.publish(EventReported(Event(EventKind.PROBLEM, "after it"), 7))
        found = last_values(port)
    expected = {
        "standing": "blocked",
        "why": "interval",
        "reason": "alarm 21612",
        "rejected": 2,
        "operator": "clean the sphere",
    }
    assert expected.items() <= found["talc/mill/probing"].items()
    assert expected.items() <= found["talc/mill/status"]["probing"].items()


async def test_a_key_that_zenoh_refuses_is_reported_once_whatever_else_is_published(
    caplog: pytest.LogCaptureFixture,
) -> None:
    refused = [replace(reading(20.5), channel=f"bed#{number}") for number in range(2)]
    async with telemetry(free_port()) as t:
        for _ in range(3):
            t.publish(ReadingsTaken(refused))
            t.publish(problem("after it"))
        t.publish(ReadingsTaken([replace(reading(20.5), channel="last#")]))
        await until(lambda: any("last#" in message for message in caplog.messages))
    said = [message.partition(" was not published: ")[0] for message in caplog.messages]
    assert said == ["telemetry: reading/bed#0", "telemetry: reading/bed#1", "telemetry: reading/last#"]
