"""The chart of the page for operators, used only by keyboard."""

from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import pytest
from playwright.sync_api import Page, Response, expect

from tests.benches.page_rig import LIMIT_MS, MILL_SETTINGS, page_rig, played_mill
from tests.benches.page_shifts import TWO_FRAMES

pytestmark = [pytest.mark.peer, pytest.mark.slow]

DAY_S = 86400.0

expect.set_options(timeout=LIMIT_MS)


def asked(answer: Response) -> tuple[float, float]:
    """Which past was asked for, UTC seconds; twice the same: none."""
    address = urlsplit(answer.url)
    if address.path != "/past/mill":
        return 0.0, 0.0
    told = parse_qs(address.query)
    return float(told["from"][0]), float(told["to"][0])


def asked_s(answer: Response) -> float:
    began, ended = asked(answer)
    return ended - began


def curves(page: Page) -> str:
    """What the chart draws, without the cursor over it."""
    return str(page.locator("#chart canvas").evaluate("(canvas) => canvas.toDataURL()"))


def test_the_keyboard_moves_the_cursor_of_the_chart_zooms_it_and_chooses_a_moment(tmp_path: Path) -> None:
    settings = tmp_path / "web.toml"
    settings.write_text(MILL_SETTINGS, encoding="utf-8")
    with page_rig() as rig:
        played_mill(rig, settings)
        with rig.page("/machine/mill#time") as page:
            expect(page.locator("#chart .u-over")).to_have_count(1)
            with page.expect_response(lambda answer: asked_s(answer) > 25.0 * DAY_S):
                page.select_option("#span", "720")
            page.focus("#png")
            page.keyboard.press("Tab")
            assert page.evaluate("document.activeElement.id") == "chart"
            title = page.locator("#reading-title")
            page.keyboard.press("ArrowLeft")
            expect(page.locator("#reading")).to_contain_text("µm")
            last = title.inner_text()
            page.keyboard.press("ArrowLeft")
            expect(title).not_to_have_text(last)
            whole = curves(page)
            with page.expect_response(lambda answer: 0.0 < asked_s(answer) < 10.0 * DAY_S) as closer:
                for _ in range(6):
                    page.keyboard.press("ArrowLeft")
                for _ in range(2):
                    page.keyboard.press("+")
            with page.expect_response(lambda answer: asked_s(answer) > 0.0) as earlier:
                page.keyboard.press("PageUp")
            assert asked(earlier.value)[0] < asked(closer.value)[0]
            zoomed = curves(page)
            assert zoomed != whole
            with page.expect_response(lambda answer: "/corrections/mill?before=" in answer.url):
                page.keyboard.press("Enter")
            expect(page.locator("#moment-title")).to_contain_text("·")
            page.keyboard.press("Home")
            page.evaluate(TWO_FRAMES)
            assert curves(page) != zoomed
            page.keyboard.press("Tab")
            assert page.evaluate("document.activeElement.closest('#chart')") is None, "the keyboard leaves the chart"
