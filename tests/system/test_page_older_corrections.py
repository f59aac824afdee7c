"""Every correction's line is on the page, also those from before it was opened: fetched from the gateway's store."""

from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.benches.page_rig import LIMIT_MS, MILL_SETTINGS, page_rig, played_mill
from tests.benches.waits import wait_until

pytestmark = [pytest.mark.peer, pytest.mark.slow]

STORED_HOURS = 7 * 24
"""The played gateway has published its reasons at each hour of the last seven days."""

expect.set_options(timeout=LIMIT_MS)


def lines(page: Page) -> int:
    return page.locator("#corrections tbody tr").count()


def test_scrolling_and_the_button_show_what_is_stored_until_its_beginning(tmp_path: Path) -> None:
    settings = tmp_path / "web.toml"
    settings.write_text(MILL_SETTINGS, encoding="utf-8")
    with page_rig() as rig:
        played_mill(rig, settings)
        with rig.page("/machine/mill") as page:
            expect(page.locator("#corrections tbody tr")).not_to_have_count(0)
            page.select_option("#correction-error", "EZ0A")
            heard = lines(page)
            with page.expect_response(lambda answer: "/corrections/mill?before=" in answer.url):
                page.click("#corrections-older")
            expect(page.locator("#corrections tbody tr")).to_have_count(heard + 40)
            with page.expect_response(lambda answer: "/corrections/mill?before=" in answer.url):
                page.locator("#corrections").evaluate("(table) => table.parentNode.scrollTo(0, 1e6)")
            expect(page.locator("#corrections tbody tr")).to_have_count(heard + 80)
            older = page.locator("#corrections-older")

            def at_the_beginning() -> bool:
                older.evaluate("(button) => button.click()")  # nothing if the page has come there by itself meanwhile
                return older.is_disabled()

            wait_until(at_the_beginning)
            expect(page.locator("#corrections-older-note")).to_have_text("No earlier ones are stored.")
            # The day that is heard is stored, too; from its first line back each hour has one.
            assert STORED_HOURS - 25 <= lines(page) - heard <= STORED_HOURS
            times = page.locator("#corrections tbody td.when:first-child").all_inner_texts()
            assert len(times) == len(set(times)), "none twice"
            expect(page.locator("#corrections tbody tr").last).to_contain_text("spindle_rear +1.0")
