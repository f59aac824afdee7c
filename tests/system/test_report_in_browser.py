"""The report as a browser shows it: mouse and fingers on a chart, hours without dates, nothing wider than a phone."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from playwright.sync_api import CDPSession, Page, expect

from gateway.reporting.page import build
from tests.benches.page_rig import LIMIT_MS, chromium
from tests.benches.small_run import small_run

pytestmark = [pytest.mark.peer, pytest.mark.slow]

WIDTH, HEIGHT = 390, 844
expect.set_options(timeout=LIMIT_MS)


@contextmanager
def opened(file: Path, steps: int, width: int, *, fingers: bool) -> Iterator[Page]:
    """The report of a run of five-minute steps in a browser, whose console stays empty."""
    file.write_text(build(small_run(steps)), encoding="utf-8")
    with chromium() as browser:
        screen = browser.new_context(
            viewport={"width": width, "height": HEIGHT}, has_touch=fingers, is_mobile=fingers, device_scale_factor=2
        )
        screen.set_default_timeout(LIMIT_MS)
        shown, said = screen.new_page(), list[str]()
        shown.on("console", lambda message: said.append(message.text))
        shown.on("pageerror", lambda error: said.append(str(error)))
        shown.goto(file.as_uri())
        yield shown
        assert said == []


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Page]:
    """A report of 24 h on a phone."""
    with opened(tmp_path / "report.html", 288, WIDTH, fingers=True) as shown:
        yield shown


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Page]:
    """A report from 07:00 to 07:00 on a screen with a mouse."""
    with opened(tmp_path / "report.html", 289, 1280, fingers=False) as shown:
        yield shown


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


class Mouse:
    """A mouse on the second chart, at shares of its width."""

    def __init__(self, page: Page) -> None:
        over = page.locator(".u-over").nth(1)
        over.scroll_into_view_if_needed()
        box = over.bounding_box()
        assert box is not None
        self._mouse, self._left, self._width = page.mouse, box["x"], box["width"]
        self._y = box["y"] + box["height"] / 2

    def to(self, share: float) -> None:
        self._mouse.move(self._left + share * self._width, self._y, steps=5)

    def drag(self, begin: float, end: float) -> None:
        self.to(begin)
        self._mouse.down()
        self.to(end)
        self._mouse.up()

    def click_twice(self, share: float) -> None:
        self._mouse.dblclick(self._left + share * self._width, self._y)


def spans_h(page: Page) -> list[tuple[float, float]]:
    """First and last hour of the day that each chart shows, by where its marks stand."""
    found = []
    for chart in page.locator(".uplot").all():
        over = chart.locator(".u-over")
        left, width = over.evaluate("(o) => [o.offsetLeft, o.offsetWidth]")
        placed = chart.locator(".numbers .x").evaluate_all("all => all.map((m) => [m.textContent, m.style.left])")
        at = [
            (float(place.removesuffix("px")) - left, int(time[:2]) + int(time[3:]) / 60)
            for time, place in placed
            if re.fullmatch(r"\d\d:\d\d", time)
        ]
        (x, hour), (other, later) = at[:2]
        assert other > x
        an_hour = (other - x) / (later - hour)
        found.append((hour - x / an_hour, hour + (width - x) / an_hour))
    return found


def all_show(page: Page, begin_h: float, end_h: float) -> None:
    """Every chart shows this stretch of time, to three minutes (a pixel is one and a half)."""
    page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    shown = spans_h(page)
    assert len(shown) >= 4
    for span in shown:
        assert span == pytest.approx((begin_h, end_h), abs=0.05)


def pointed_at(page: Page) -> tuple[list[str], list[float]]:
    """The time that each chart writes for its cursor, and where it draws that, as a share of its width."""
    times = [chart.locator(".u-legend .u-value").first.inner_text() for chart in page.locator(".uplot").all()]
    shares = page.locator(".u-over").evaluate_all(
        "all => all.map((over) => new DOMMatrix(over.querySelector('.u-cursor-x').style.transform).m41"
        " / over.clientWidth)"
    )
    return times, shares


def test_the_mouse_points_at_a_time_in_every_chart_and_dragged_over_one_shows_that_time_in_all(desk: Page) -> None:
    mouse = Mouse(desk)
    for share, time in ((0.5, "19:00"), (0.25, "13:00")):
        mouse.to(share)
        expect(desk.locator(".uplot").nth(1).locator(".u-legend .u-value").first).to_contain_text(time)
        times, shares = pointed_at(desk)
        assert len(times) >= 4
        assert len(set(times)) == 1
        assert shares == pytest.approx([share] * len(shares), abs=0.002)
    all_show(desk, 7, 31)
    mouse.drag(0.25, 0.5)
    all_show(desk, 13, 19)
    mouse.drag(0.75, 0.25)  # from right to left, within what is shown
    all_show(desk, 14.5, 17.5)
    desk.get_by_role("button", name="earlier").click()  # the buttons go on from there
    all_show(desk, 13, 16)
    mouse.click_twice(0.5)
    all_show(desk, 7, 31)
