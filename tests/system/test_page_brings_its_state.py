"""The state that the page for operators brings with it: drawn before the stream answers, and never taken for fresh."""

import json
import re
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.benches.page_rig import LIMIT_MS, page_rig, played_mill

pytestmark = [pytest.mark.peer, pytest.mark.slow]

VERDICT = re.compile("^(Ready|Not sure|Not ready)$")

expect.set_options(timeout=LIMIT_MS)


def drive_its_clock(page: Page) -> None:
    """Drive the page's clock from the next load on; no stream is answered any more."""
    page.route(re.compile(r"/stream[/?]"), lambda _: None)
    page.clock.install()
    page.clock.pause_at(page.evaluate("Date.now()") / 1e3 + 1.0)


def test_it_is_drawn_at_once_and_lost_with_the_server(settings: Path) -> None:
    with page_rig() as rig:
        gateway = played_mill(rig, settings)
        name = "</script><script>document.title='forged'</script>"
        gateway.say("reading/forged " + json.dumps({"channel": name, "value": 1.0}))
        with rig.page("/machine/mill") as page:
            expect(page.locator("#channels")).to_contain_text(name)
            drive_its_clock(page)
            page.reload()
            expect(page.locator("#word")).to_have_text(VERDICT)
            expect(page.locator("#axes [data-axis=Z] [data-of=half]")).not_to_have_text("–")
            expect(page.locator("#channels")).to_contain_text(name)
            expect(page.locator("#event-kind option")).not_to_have_count(2)
            assert "forged" not in page.title()
            page.clock.run_for(6000)
            expect(page.locator("#lost")).to_be_hidden()
            page.clock.run_for(2000)
            expect(page.locator("#word")).to_have_text("No connection")
            expect(page.locator("#lost")).to_contain_text(re.compile(r"state of \d\d:\d\d\."))
            expect(page.locator("#axes [data-axis=Z] [data-of=half]")).to_have_text("–")
        with rig.page("/?all=1") as machines:
            expect(machines.locator("#machines .word")).to_have_text(VERDICT)
            drive_its_clock(machines)
            machines.reload()
            expect(machines.locator("#machines .word")).to_have_text(VERDICT)


def test_it_is_not_drawn_for_a_browser_with_its_own_tolerance(settings: Path) -> None:
    with page_rig() as rig:
        played_mill(rig, settings)
        with rig.page("/machine/mill") as page:
            expect(page.locator("#word")).to_have_text(VERDICT)
            page.fill("#tolerance", "3")
            page.keyboard.press("Enter")
            expect(page.locator("#word")).to_have_text("Not sure")
            drive_its_clock(page)
            page.reload()
            expect(page.locator("#tolerance")).to_have_value("3")
            expect(page.locator("#word")).to_be_empty()
            page.clock.run_for(8000)
            expect(page.locator("#lost")).to_contain_text("cannot reach its server, and has nothing to show yet")
