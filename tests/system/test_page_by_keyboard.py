"""The charts of the page for operators, used only by keyboard."""

from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import pytest
from playwright.sync_api import Locator, Page, Response, expect

from tests.benches.page_rig import LIMIT_MS, MILL_SETTINGS, page_rig, played_mill

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


def times(readings: Locator) -> set[str]:
    """The times at which the charts show their values."""
    return {told.partition(": ")[0] for told in readings.all_inner_texts()}


def curves(page: Page, axis: str) -> str:
    """What a chart draws, without the cursor over it."""
    return str(page.locator(f"[data-axis={axis}] canvas").evaluate("(canvas) => canvas.toDataURL()"))


def focused(page: Page) -> str:
    return str(page.evaluate("document.activeElement.closest('article').dataset.axis"))


def test_the_keyboard_moves_the_cursor_of_all_charts_and_zooms_them(tmp_path: Path) -> None:
    settings = tmp_path / "web.toml"
    settings.write_text(MILL_SETTINGS, encoding="utf-8")
    with page_rig() as rig:
        played_mill(rig, settings)
        with rig.page("/machine/mill") as page:
            readings = page.locator("#axes .reading")
            expect(page.locator("#axes .u-over")).to_have_count(3)
            with page.expect_response(lambda answer: asked_s(answer) > 25.0 * DAY_S):
                page.select_option("#span", "720")
            page.locator("[data-axis=X] .chart").focus()
            page.keyboard.press("Tab")
            assert focused(page) == "Y"
            page.keyboard.press("ArrowLeft")
            expect(readings).to_contain_text(["µm"] * 3)
            (last,) = times(readings)
            page.keyboard.press("ArrowLeft")
            expect(readings.first).not_to_contain_text(last)
            assert len(times(readings)) == 1, "one cursor"
            assert [note.get_attribute("aria-live") for note in readings.all()] == ["off", "polite", "off"]
            whole = [curves(page, axis) for axis in "XZ"]
            with page.expect_response(lambda answer: 0.0 < asked_s(answer) < 10.0 * DAY_S) as closer:
                for _ in range(6):
                    page.keyboard.press("ArrowLeft")
                for _ in range(2):
                    page.keyboard.press("+")
            with page.expect_response(lambda answer: asked_s(answer) > 0.0) as earlier:
                page.keyboard.press("PageUp")
            assert asked(earlier.value)[0] < asked(closer.value)[0]
            zoomed = [curves(page, axis) for axis in "XZ"]
            assert all(near != far for near, far in zip(zoomed, whole, strict=True)), "the others are zoomed, too"
            page.keyboard.press("Home")
            page.keyboard.press("Tab")
            assert focused(page) == "Z"
            page.keyboard.press("ArrowRight")
            expect(readings).to_contain_text(["µm"] * 3)
            assert all(curves(page, axis) != near for axis, near in zip("XZ", zoomed, strict=True))
            page.keyboard.press("Tab")
            assert page.evaluate("document.activeElement.id") == "span", "the keyboard leaves the charts"
