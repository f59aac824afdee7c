"""The tolerance and the point of the work space, as people type them, and what the list of machines makes of them."""

import json
import re

import pytest
from playwright.sync_api import Page, expect

from tests.benches.page_rig import LIMIT_MS, PageRig

pytestmark = [pytest.mark.peer, pytest.mark.slow]

TOLERANCE = "input[name=tolerance]"

expect.set_options(timeout=LIMIT_MS)


def typed(page: Page, text: str) -> None:
    """Type by the keyboard, as a person does who then goes on to the next field."""
    expect(page.locator(TOLERANCE)).to_be_visible()
    page.focus(TOLERANCE)
    page.keyboard.press("Control+A")
    page.keyboard.type(text)
    page.keyboard.press("Tab")


def kept(page: Page) -> object:
    return json.loads(page.evaluate("localStorage.getItem('asked mill')") or "{}")


@pytest.mark.parametrize(("locale", "shown"), [("de-DE", "5,5")])
def test_a_tolerance_may_have_a_comma_or_a_point_in_every_locale(looked_at: PageRig, locale: str, shown: str) -> None:
    with looked_at.page("/machine/mill?lang=en", locale=locale) as page:
        origin = page.locator("#tolerance-from")
        expect(page.locator(TOLERANCE)).to_have_value("8")
        expect(origin).to_have_text("as configured")
        for text in ("5,5", "5.5", " ± 5,5 µm"):
            typed(page, "7")
            expect(page.locator(TOLERANCE)).to_have_value("7")
            typed(page, text)
            expect(page.locator(TOLERANCE)).to_have_value(shown)
            expect(origin).to_have_text("typed in on this screen")
            assert kept(page) == {"tolerance": "5.5"}
        for text in ("5,5,5", "0", "-3", "1e9", "much"):
            typed(page, text)
            told = page.evaluate("document.getElementById('tolerance').validationMessage")
            assert told == f"A number from {shown.replace('5.5', '0.1').replace('5,5', '0,1')} to 10" + (
                f",000, such as {shown}" if locale == "en-GB" else f".000, such as {shown}"
            )
            assert kept(page) == {"tolerance": "5.5"}, "what is no tolerance changes nothing"
        typed(page, "8")
        expect(origin).to_have_text("as configured")
        assert kept(page) == {}


def test_the_list_of_machines_judges_by_the_tolerance_of_this_browser(looked_at: PageRig) -> None:
    with looked_at.page("/machine/mill") as page:
        expect(page.locator("#word")).to_have_text(re.compile("^(Ready|Not sure)$"))
        for tolerance, verdict in (("1000", "Ready"), ("0,1", "Not ready|Not sure")):
            typed(page, tolerance)
            expect(page.locator("#word")).to_have_text(re.compile(f"^({verdict})$"))
            own = page.locator("#word").inner_text()
            with page.context.expect_page() as opened:
                page.evaluate("open('/?all=1', '_blank', 'noopener')")
            expect(opened.value.locator("#machines .word")).to_have_text(own)
        for nonsense in ("{", '{"tolerance": "-1", "x": "left", "z": 5, "q": {}}'):
            page.evaluate("(text) => localStorage.setItem('asked mill', text)", nonsense)
            page.reload()
            expect(page.locator("#word")).to_have_text(re.compile("^(Ready|Not sure|Not ready)$"))
            expect(page.locator(TOLERANCE)).to_have_value("8")
