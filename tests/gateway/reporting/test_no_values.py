"""Values that were none are named with their column and counted: by `replay`, and by a gateway's report."""

import html
import math
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gateway.config.file import parse
from gateway.control.replay.run import Request, run_recording
from gateway.control.restart.rebuild import controller_of
from gateway.model.events import EventReported
from gateway.reporting.data import ReportData
from gateway.reporting.no_values import no_values
from gateway.reporting.page import build
from gateway.reporting.recordings.columns import Columns
from gateway.service.report_data import collect
from gateway.storage.store import Store
from talc.frame import Event, EventCode, EventKind, Frame, Measurement
from tests.benches.service_file import MACHINE, adam6015
from tests.benches.small_run import small_run
from tests.benches.stepped_clock import SteppedClock
from tests.benches.stored_steps import record_step

STEP_S, ROWS, BEGIN, FIRST_K = 300.0, 90, 60, 5_000_000
CELLS = (60, 62, 63, 66, 70, 71, 75, 77, 80, 84)
STUCK = slice(72, 80)
Array = NDArray[np.float64]
FILE = MACHINE + '[storage]\npath = "a.sqlite"\n' + adam6015("front = 0, rear = 1")


def warming() -> tuple[Array, Array]:
    """(ROWS, 2) temperatures, ten cells of the first one 85 °C; (ROWS,) an error at its sensor's limit for a while."""
    draw, at = np.random.default_rng(0), np.arange(ROWS)
    inputs = 20.0 + np.column_stack([0.1 * at, 4.0 * np.sin(at / 9.0)]) + draw.normal(0.0, 0.05, (ROWS, 2))
    error = 3.0 * (inputs[:, 0] - inputs[0, 0]) + draw.normal(0.0, 0.2, ROWS)
    inputs[list(CELLS), 0] = 85.0
    error[STUCK] = 999.999
    return inputs.round(2), error.round(3)


def test_replay_names_the_cells_and_the_measurements_on_the_terminal_and_on_its_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    inputs, error = warming()
    lines = [
        f"{k * 300},{a},{b},{e}" for k, (a, b), e in zip(range(ROWS), inputs.tolist(), error.tolist(), strict=True)
    ]
    table, page = tmp_path / "warm.csv", tmp_path / "page.html"
    table.write_text("\n".join(["time,front,rear,EZ0A", *lines]) + "\n", encoding="utf-8")
    run_recording(Request(table, Columns(), page, config=None, every_measurement=True))
    said = [line for line in capsys.readouterr().out.splitlines() if line.startswith(("front:", "rear:", "EZ0A:"))]
    assert len(said) == 2, said
    assert "85 °C" in said[0]
    assert (f" {len(CELLS)} " in said[0], f" {BEGIN / 12:.1f} h" in said[0]) == (True, True)
    assert f" {STUCK.stop - STUCK.start - 1} " in said[1], "the first one is an outlier that might be true"
    shown = html.unescape(page.read_text(encoding="utf-8"))
    assert said[1] in shown
    assert f"front: no value of it in {len(CELLS)} steps" in shown


def collected(folder: Path, inputs: Array, error: Array | None = None) -> ReportData:
    """What a gateway stored that had these inputs, and measured the error at each step."""
    config, clock = parse(FILE, folder / "gateway.toml"), SteppedClock()
    controller = controller_of(config)
    with Store(config.storage.path, "boot", clock) as store:
        store.begin(config.canonical(), config.fingerprint(), "")
        for row in range(ROWS):
            clock.set_utc(datetime.fromtimestamp((FIRST_K + row) * STEP_S + 0.2, UTC))
            errors = np.full(9, math.nan)
            errors[1] = math.nan if error is None else error[row]
            measurement = None if error is None else Measurement(errors, np.full(9, 0.5))
            frame = Frame(FIRST_K + row, inputs[row], np.ones(2, dtype=np.bool_), measurement)
            decision, _ = record_step(store, controller, frame)
            for event in decision.events:
                store.record(EventReported(event, frame.k))
    return collect(config.storage.path)


def test_a_gateway_s_report_counts_what_its_learner_took_for_no_value(tmp_path: Path) -> None:
    data = collected(tmp_path, *warming())
    (cells_at, cells), (_, stuck) = no_values(data)
    assert cells_at == data.moment(BEGIN * STEP_S)
    assert (cells.startswith("front:"), f" {len(CELLS)} " in cells) == (True, True)
    assert (stuck.startswith("EZ0A:"), f" {STUCK.stop - STUCK.start - 1} " in stuck) == (True, True)
    assert all(text in html.unescape(build(data)) for text in (cells, stuck))


def test_a_fault_that_lasts_counts_until_the_last_step(tmp_path: Path) -> None:
    inputs, _ = warming()
    inputs[list(CELLS), 0] = inputs[0, 0]
    inputs[BEGIN:, 0] = -127.0
    ((_, said),) = no_values(collected(tmp_path, inputs))
    assert (said.startswith("front:"), f" {ROWS - BEGIN} " in said) == (True, True)


def test_exchanged_inputs_are_both_named_and_each_ends_by_itself() -> None:
    kind, pair = EventKind.INPUT_SUBSTITUTED, {"input": "front", "other": "rear"}
    begun = Event(kind, code=EventCode.INPUTS_EXCHANGED, values=pair)
    ended = [Event(kind, code=EventCode.VALUE_GOOD_AGAIN, values={"input": name}) for name in pair.values()]
    events = ((10 * STEP_S, begun), (22 * STEP_S, ended[0]), (25 * STEP_S, ended[1]), (30 * STEP_S, ended[1]))
    first, second = (said for _, said in no_values(replace(small_run(48), events=events)))
    assert (first.startswith("front:"), " 12 " in first, "rear" in first) == (True, True, True)
    assert (second.startswith("rear:"), " 15 " in second, "front" in second) == (True, True, True)


def test_a_run_without_such_values_says_nothing_of_them() -> None:
    missing = Event(EventKind.INPUT_SUBSTITUTED, code=EventCode.VALUE_ESTIMATED, values={"input": "front"})
    again = Event(EventKind.INPUT_SUBSTITUTED, code=EventCode.VALUE_GOOD_AGAIN, values={"input": "front"})
    assert no_values(replace(small_run(48), events=((STEP_S, missing), (5 * STEP_S, again)))) == []
