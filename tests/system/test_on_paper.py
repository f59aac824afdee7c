"""The report and the pages of the studies on paper: nothing is cut off, no heading ends a sheet; and on a phone."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser, Page

from gateway.reporting.data import ReportData
from gateway.reporting.page import build
from talc.explanation import ErrorReason, Reasons
from talc.frame import Event, EventKind, Why
from talc.names import THERMAL_ERRORS
from tests.benches.page_rig import LIMIT_MS, chromium
from tests.benches.paper import cut_off, left_alone, printed, printed_texts, torn
from tests.benches.small_run import small_run

pytestmark = [pytest.mark.peer, pytest.mark.slow]

STUDIES = Path(__file__).parents[2] / "docs" / "studies"
PAGES = ("report", *(file.stem for file in sorted(STUDIES.glob("*.html"))))
MOST_SHEETS = 16


def full_run() -> ReportData:
    """Three days with everything that a page can contain: shifts, many inputs and events, reasons with long texts."""
    run = small_run(3 * 288)
    names = tuple(f"input_{i}_of_the_machine" for i in range(20))
    waves = 20.0 + np.sin(np.arange(3 * 288)[:, None] / 40.0 + np.arange(20)) * 10.0 ** (np.arange(20) % 4)
    moved = tuple((name, 3.0 - 0.5 * i) for i, name in enumerate(names[:5]))
    experts = (("chosen inputs", 0.5), ("all inputs", 0.3), ("last measurement held", 0.2))
    reason = ErrorReason("", 12.25, True, 0.5, moved, -0.5, 0.25, experts, 12.5, 1.5)
    errors = tuple(replace(reason, error=error) for error in THERMAL_ERRORS)
    told = "bus can1, device fluids: node 5: no answer within 0.5 s (check power, termination, node id and bitrate)"
    return replace(
        run,
        input_names=names,
        inputs=waves,
        input_units=("degC",) * 8 + ("1/min",) * 4 + ("kW",) * 4 + ("",) * 4,
        moved=np.tile(np.linspace(3.0, 1.0, 20), (9, 1)),
        reasons=Reasons(int(run.k[-1]), int(run.k[-1]) + 24, Why.UNCERTAINTY, errors),
        events=tuple((3600.0 * i, Event(EventKind.PROBLEM, told)) for i in range(70)),
        channel_health={name: {"good": 800, "comm_fault": 64} for name in names},
    )


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as started:
        yield started


@pytest.fixture(scope="module", params=PAGES)
def file(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a page."""
    if request.param != "report":
        return STUDIES / f"{request.param}.html"
    report = tmp_path_factory.mktemp("report") / "report.html"
    report.write_text(build(full_run()), encoding="utf-8")
    return report


@pytest.fixture
def page(browser: Browser, file: Path) -> Iterator[Page]:
    """The page as a person sees it before printing: in dark mode, which paper is not."""
    with browser.new_context(color_scheme="dark") as context:
        context.set_default_timeout(LIMIT_MS)
        shown = context.new_page()
        shown.goto(file.as_uri())
        shown.emulate_media(media="print")
        yield shown


@pytest.mark.parametrize("paper", ["A4", "Letter"])
def test_nothing_is_cut_off_and_no_heading_ends_a_sheet(page: Page, tmp_path: Path, paper: str) -> None:
    rows, headings = printed_texts(page, "tbody tr"), printed_texts(page, "h2, h3, caption, thead tr")
    sheets = printed(page, tmp_path, paper)
    assert len(sheets) <= MOST_SHEETS
    assert cut_off(sheets) == []
    assert torn(rows, sheets) == []
    assert left_alone(headings, sheets) == []


@pytest.mark.parametrize("name", PAGES[1:])
def test_the_findings_are_as_wide_as_a_phone(browser: Browser, name: str) -> None:
    with browser.new_context(viewport={"width": 390, "height": 844}, is_mobile=True) as phone:
        shown = phone.new_page()
        shown.set_default_timeout(LIMIT_MS)
        shown.goto((STUDIES / f"{name}.html").as_uri())
        assert shown.evaluate("document.documentElement.scrollWidth") == 390
        assert shown.evaluate("document.querySelector('.claims').parentNode.scrollWidth") < 390


@pytest.mark.parametrize("name", PAGES[1:])
def test_a_built_page_has_the_style_of_a_new_one(name: str) -> None:
    pages = [STUDIES / f"{name}.html", STUDIES.parents[1] / "studies" / "page.html"]
    built, new = (page.read_text(encoding="utf-8").partition("</style>")[0].partition("<style>")[2] for page in pages)
    assert built == new
