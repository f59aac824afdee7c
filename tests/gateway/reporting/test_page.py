"""The page: one well-formed file of bounded size that loads nothing, readable without a script, in local time."""

import json
import re
from dataclasses import replace
from datetime import UTC, datetime, time
from html.parser import HTMLParser
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from gateway.reporting.data import CycleSeen, ReportData, Truth
from gateway.reporting.figures import summary
from gateway.reporting.first_lines import by_shift
from gateway.reporting.page import build
from talc.frame import Event, EventKind, Phase
from talc.names import THERMAL_ERRORS
from tests.benches.small_run import START, small_run

VOID = {"meta", "br", "link", "img", "input", "hr"}
MOST_BYTES = 3_000_000


class StrictHtmlReader(HTMLParser):
    """Fails at a tag that is not closed, or closed twice; collects what accessibility and printing need."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.loads: list[str] = []
        self.ids: list[str] = []
        self.tables: list[dict[str, int]] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        named = dict(attrs)
        if tag not in VOID:
            self.open.append(tag)
        self.loads += [v for k, v in attrs if k in ("src", "href", "xlink:href") and v and not v.startswith("#")]
        self.ids += [named["id"] or ""] if "id" in named else []
        if tag == "table":
            self.tables.append({"caption": 0, "bare": 0})
        elif tag == "caption":
            self.tables[-1]["caption"] += 1
        elif tag == "th":
            self.tables[-1]["bare"] += named.get("scope") not in ("col", "row")

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.handle_endtag(tag)

    def handle_data(self, data: str) -> None:
        self.text += data


def read(page: str) -> StrictHtmlReader:
    reader = StrictHtmlReader()
    reader.feed(page)
    reader.close()
    assert reader.open == []
    return reader


def series_of(page: str) -> dict[str, Any]:
    """What the script draws."""
    found = re.search(r'<script type="application/json" id="series">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    return dict(json.loads(found[1]))


def unmeasured() -> ReportData:
    """A small run before its first measurement: its page has no charts of errors, which would take a second to draw."""
    run = small_run()
    phases = (Phase.CALIBRATION,) * len(run.phases)
    return replace(run, phases=phases, measured=np.full_like(run.measured, np.nan))


@pytest.fixture(scope="module")
def page() -> str:
    moved = np.zeros((9, 3))
    moved[1] = (0.5, 12.25, 0.0)
    told = Event(EventKind.PROBLEM, "bus can1: no answer")
    return build(replace(small_run(), moved=moved, events=((3600.0, told),)))


@pytest.mark.slow
def test_it_is_well_formed_and_loads_nothing(page: str) -> None:
    reader = read(page)
    assert reader.loads == []
    assert len(set(reader.ids)) == len(reader.ids)
    styles = page[page.index("<style>") : page.index("</style>")]
    assert "url(" not in styles
    assert "@import" not in styles


def test_every_chart_is_a_picture_with_text_too_for_readers_without_a_script(page: str) -> None:
    stills = re.findall(r'<div class="still">(<svg.*?</svg>)', page, re.DOTALL)
    assert len(stills) == 2 + len(THERMAL_ERRORS)  # the tool, the inputs
    texts = ["".join(ElementTree.fromstring(svg).itertext()) for svg in stills]
    assert "offset on the control" in texts[0]
    assert "front" in texts[1]
    assert all(error in text for error, text in zip(THERMAL_ERRORS, texts[2:], strict=True))
    colours = set(re.findall(r"#[0-9a-f]{6}", "".join(stills)))
    assert colours == set(), "they follow the reader's light or dark"


def test_the_scripts_charts_contain_the_numbers(page: str) -> None:
    series = series_of(page)
    assert series["start"] == START
    assert series["zone"] == "Europe/Zurich"
    left = next(line for line in series["groups"]["tool"][2]["lines"] if line["label"] == "left")
    assert left["x"][:3] == [0, 300, 600]
    assert left["y"][:3] == [-4.0, 4.0, -4.0]


def test_a_speed_does_not_flatten_temperatures_of_unknown_unit() -> None:
    run = unmeasured()
    inputs = np.column_stack([np.linspace(20.0, 24.0, 48), np.linspace(0.0, 5000.0, 48), np.linspace(30.0, 31.0, 48)])
    page = build(replace(run, inputs=inputs, input_units=("", "", "")))
    charts = series_of(page)["groups"]["inputs"]
    assert [{line["label"] for line in chart["lines"]} for chart in charts] == [{"rear"}, {"front", "speed"}]


@pytest.mark.slow
def test_a_year_of_a_simulation_stays_small() -> None:
    steps = 365 * 288
    run = small_run(steps)
    minutes = np.arange(steps * 5.0) * 60.0
    noise = np.random.default_rng(1).normal(size=(minutes.size, 9))
    truth = Truth(minutes, noise, noise[:, :3], noise[:, 3:6], np.zeros(minutes.size, dtype=np.bool_))
    assert len(build(replace(run, truth=truth)).encode()) < MOST_BYTES


def test_what_a_simulated_machine_does_after_its_gateway_has_stopped_is_not_judged() -> None:
    """The machine notes the instant of the last decision once the offsets are gone."""
    run = small_run(12)
    minutes, last = np.arange(70.0) * 60.0, run.time_s[-1]
    left = np.where(minutes[:, None] >= last, 40.0, 1.0) * np.ones(3)
    truth = Truth(minutes, np.zeros((70, 9)), np.full((70, 3), 40.0), left, np.zeros(70, dtype=np.bool_))
    assert [row.compensated_e_rms for row in summary(replace(run, truth=truth)).tool] == [1.0, 1.0, 1.0]


def test_times_are_local_also_in_the_night_in_which_the_clock_goes_back() -> None:
    start = datetime(2026, 10, 24, 18, tzinfo=UTC).timestamp()  # 20:00 CEST
    run = replace(small_run(12 * 14, start=start), shifts=(time(6), time(22)))
    what, shifts = by_shift(run, summary(run))
    assert what == "Z at the tool, µm RMS"
    # 20:00 to 22:00; 22:00 to 06:00, which lasts nine hours that night; 06:00 to 09:00. A cycle of 2 min each 20 min.
    assert [(shift.when, shift.probing) for shift in shifts] == [
        ("Sat 2026-10-24 20:00 CEST", "12 min"),
        ("Sat 2026-10-24 22:00 CEST", "54 min"),
        ("Sun 2026-10-25 06:00 CET", "18 min"),
    ]


def test_a_shift_that_begins_with_the_last_step_s_end_has_not_run() -> None:
    run = small_run()  # 48 steps, the last at 10:55
    ended = replace(run, shifts=(time(7), time(10, 55)), cycles_seen=(CycleSeen(float(run.time_s[-1]), ""),))
    _, shifts = by_shift(ended, summary(ended))
    assert [(shift.when, shift.cycles) for shift in shifts] == [("Mon 2026-01-05 07:00 CET", "1")]


def test_a_gateway_s_run_lasts_from_the_begin_of_its_first_step(page: str) -> None:
    """48 steps of 5 min; the first one ended at 07:00."""
    times = re.findall(r"\b\d\d:\d\d(?= CET)", page.partition("</h1>")[2])
    assert times[:2] == ["06:55", "10:55"]


def test_the_inputs_that_moved_an_error_most_are_named_and_drawn_first(page: str) -> None:
    assert re.search(r"\brear \(12\.2 µm\), front \(0\.5 µm\)", page)
    assert "speed</text>" not in page, "it moved nothing"
