"""The page for operators in a person's hands: the keyboard alone, two fingers, and clicks on what is drawn."""

import re
from urllib.parse import parse_qs, urlsplit

import pytest
from playwright.sync_api import Page, Response, expect

from tests.benches.page_rig import LIMIT_MS, PageRig, open_screen
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


def test_the_keyboard_moves_the_cursor_of_the_chart_zooms_it_and_chooses_a_moment(looked_at: PageRig) -> None:
    with looked_at.page("/machine/mill#time") as page:
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


def test_clicks_on_a_part_a_sensor_and_a_load_and_two_fingers_on_the_chart_do_what_they_promise(
    looked_at: PageRig,
) -> None:
    with looked_at.page("/machine/mill") as page:
        page.fill("#warm-minutes", "25")
        with page.expect_response(re.compile(r"/scenario/mill\?load=&minutes=25&")) as answered:
            page.click("#warm-ask")
        assert [each["load"] for each in answered.value.json()["branches"]] == ["", "?"]
        expect(page.locator("#warm .line.asked")).to_have_count(1)
        expect(page.locator("#warm-said")).not_to_be_empty()
        page.click("#sketch [data-body=spindle] .touched")
        assert page.evaluate("location.hash") == "#sensors/spindle"
        names = page.locator("#channels .name")
        expect(names).to_have_text([re.compile("^spindle_")] * 4)
        page.click("#channels a:has-text('spindle_rear')")
        expect(page.locator("#series input:checked[name=spindle_rear]")).to_have_count(1)
        expect(page.locator("#reading")).to_contain_text(re.compile(r"spindle_rear\S+\u202f°C"))
        with page.expect_response(lambda answer: asked_s(answer) > 5.0 * DAY_S) as whole:
            page.select_option("#span", "168")
        box = page.locator("#chart .u-over").bounding_box()
        assert box is not None
        middle, fingers = box["x"] + box["width"] / 2, page.context.new_cdp_session(page)

        def touch(kind: str, apart: float) -> None:
            points = [{"x": middle + by, "y": box["y"] + 40, "id": i} for i, by in enumerate((-apart, apart))]
            fingers.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points if apart else []})

        # What the seven days still ask for, such as the temperatures, may arrive meanwhile.
        with page.expect_response(lambda answer: 0.0 < asked_s(answer) < 0.5 * asked_s(whole.value)):
            for kind, apart in (("touchStart", 50.0), ("touchMove", 100.0), ("touchMove", 200.0), ("touchEnd", 0.0)):
                touch(kind, apart)


def test_each_screen_says_since_or_until_when_and_the_wheel_turns_to_what_has_no_room(looked_at: PageRig) -> None:
    with looked_at.page("/machine/mill", 1024, 600) as page:
        page.fill("input[name=tolerance]", "3")  # what would help needs more than one page
        page.keyboard.press("Enter")
        expect(page.locator("#helps p").nth(5)).to_be_attached()
        # The last estimate is of three minutes ago; the last status is not.
        present = "(label) => [0, 60e3].some((ms) => label === new Date(Date.now() - ms).toTimeString().slice(0, 5))"
        assert page.locator("#strip .now").evaluate(f"(mark) => ({present})(mark.textContent)")
        page.locator(".inside").hover()
        page.mouse.wheel(0.0, 100.0)
        page.wait_for_function("document.querySelector('.inside').scrollLeft > 0")
        since = page.locator("#since").inner_text()
        assert since
        for screen in ("time", "why", "sensors", "log"):
            open_screen(page, screen)
            expect(page.locator("#badge a")).to_contain_text(since)
            expect(page.locator("#badge a")).to_be_visible()
        open_screen(page, "now")
        page.fill("input[name=tolerance]", "1000")
        page.keyboard.press("Enter")
        expect(page.locator("#until")).not_to_be_empty()
        until, since = page.locator("#until").inner_text(), page.locator("#since").inner_text()
        expect(page.locator("#helps p").first).to_contain_text(until)
        open_screen(page, "time")
        expect(page.locator("#badge a")).to_contain_text(until)
        expect(page.locator("#badge a")).to_contain_text(since)
