"""The report as a browser shows it: fingers on a chart, hours without dates, and no scroll sideways on a phone."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import CDPSession, Page, expect, sync_playwright

from gateway.report import ReportData, build
from tests.benches.page_rig import CHROMIUM, LIMIT_MS
from tests.benches.small_run import small_run

pytestmark = [pytest.mark.peer, pytest.mark.slow]

WIDTH, HEIGHT = 390, 844
expect.set_options(timeout=LIMIT_MS)


@pytest.fixture
def run() -> ReportData:
    return small_run(288)


@pytest.fixture
def page(tmp_path: Path, run: ReportData) -> Iterator[Page]:
    """A report of 24 h on a phone, which said nothing in its console."""
    file = tmp_path / "report.html"
    file.write_text(build(run), encoding="utf-8")
    assert CHROMIUM.exists(), "chromium is missing: install Debian's chromium"
    with (
        sync_playwright() as playwright,
        playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"]) as browser,
    ):
        phone = browser.new_context(
            viewport={"width": WIDTH, "height": HEIGHT}, has_touch=True, is_mobile=True, device_scale_factor=2
        )
        phone.set_default_timeout(LIMIT_MS)
        shown, said = phone.new_page(), list[str]()
        shown.on("console", lambda message: said.append(message.text))
        shown.on("pageerror", lambda error: said.append(str(error)))
        shown.goto(file.as_uri())
        yield shown
        assert said == []


class Hand:
    """Fingers on the second chart, at shares of its width."""

    def __init__(self, page: Page) -> None:
        self._page, self._over = page, page.locator(".u-over").nth(1)
        self._over.scroll_into_view_if_needed()
        box = self._over.bounding_box()
        assert box is not None
        self._box = box
        self._session: CDPSession = page.context.new_cdp_session(page)

    def _send(self, kind: str, shares: tuple[float, ...]) -> None:
        y = self._box["y"] + self._box["height"] / 2
        points = [{"x": self._box["x"] + share * self._box["width"], "y": y, "id": n} for n, share in enumerate(shares)]
        self._session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    def drag(self, begin: tuple[float, ...], end: tuple[float, ...]) -> None:
        """Put down, move in ten steps and lift."""
        self._send("touchStart", begin)
        for step in range(1, 11):
            self._send("touchMove", tuple(a + (b - a) * step / 10 for a, b in zip(begin, end, strict=True)))
        self._page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
        self._send("touchEnd", ())


def marks(page: Page, chart: int) -> list[str]:
    """The times below a chart."""
    return page.locator(".uplot").nth(chart).locator(".numbers .x").all_inner_texts()


def shows(page: Page, chart: int, time: str, count: int) -> None:
    """Wait until a time stands below a chart, or does not."""
    expect(page.locator(".uplot").nth(chart).locator(".numbers .x", has_text=time)).to_have_count(count)


def test_two_fingers_stretch_the_time_of_every_chart_and_one_moves_it(page: Page) -> None:
    whole = marks(page, 1)
    assert whole[:2] == ["12:00", "18:00"]  # from 07:00 on
    hand = Hand(page)
    hand.drag((0.4, 0.6), (0.1, 0.9))  # four times as wide: 6 h about the middle, 19:00
    for chart in (1, 3):
        shows(page, chart, "18:00", 1)
        shows(page, chart, "20:00", 1)
        shows(page, chart, "12:00", 0)
    hand.drag((0.2,), (0.7,))  # 3 h back
    shows(page, 1, "18:00", 1)
    shows(page, 1, "14:00", 1)
    shows(page, 1, "20:00", 0)
    hand.drag((0.1, 0.9), (0.45, 0.55))
    expect(page.locator(".uplot").nth(1).locator(".numbers .x")).to_have_text(whole)


def test_nothing_is_wider_than_a_phone(page: Page) -> None:
    assert page.evaluate("document.documentElement.scrollWidth") <= WIDTH
    assert page.evaluate("getComputedStyle(document.querySelector('.touch')).display") == "inline"


@pytest.mark.parametrize("run", [replace(small_run(24), step_s=10.0, compensation_s=10.0 * np.arange(24.0))])
def test_no_minute_of_a_short_run_is_marked_twice(page: Page) -> None:
    """Four minutes of a rehearsal: half minutes would have the same text."""
    page.set_viewport_size({"width": 1280, "height": HEIGHT})
    page.reload()
    whole = marks(page, 1)
    assert len(whole) >= 2
    assert len(set(whole)) == len(whole)


@pytest.mark.parametrize("run", [replace(small_run(288, start=0.0), origin_s=0.0)])
def test_a_recording_without_dates_shows_hours(page: Page) -> None:
    assert marks(page, 1) == ["0:00 h", "6:00 h", "12:00 h", "18:00 h"]
    page.locator(".u-over").nth(1).hover()
    expect(page.locator(".uplot").nth(1).locator(".u-legend .u-value").first).to_have_text("11:55 h")
