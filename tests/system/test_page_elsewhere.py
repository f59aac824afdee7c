"""Times and numbers of the page in other languages and time zones, also when clocks are put forward and back."""

import json
import re
from pathlib import Path
from urllib.parse import quote

import pytest
from playwright.sync_api import expect

from tests.benches.page_rig import LIMIT_MS, MILL_SETTINGS, page_rig, played_mill

pytestmark = [pytest.mark.peer, pytest.mark.slow]

expect.set_options(timeout=LIMIT_MS)

CHANGES = (
    "2026-03-08T06:59:00+00:00", "2026-03-08T07:00:00+00:00",  # New York goes to summer time
    "2026-03-29T00:59:00+00:00", "2026-03-29T01:00:00+00:00",  # Berlin, too
    "2026-10-25T00:30:00+00:00", "2026-10-25T01:30:00+00:00",  # Berlin goes back: there is a second 02:30
)  # fmt: skip
PLACES = {
    ("de-DE", "Europe/Berlin"): (
        ["So., 8. März, 07:59", "So., 8. März, 08:00", "So., 29. März, 01:59", "So., 29. März, 03:00",
         "So., 25. Okt., 02:30 MESZ", "So., 25. Okt., 02:30 MEZ"],
        "1.234,5\u202f°C", "Störung",
    ),
    ("en-US", "America/New_York"): (
        ["Sun, Mar 8, 01:59 AM", "Sun, Mar 8, 03:00 AM", "Sat, Mar 28, 08:59 PM", "Sat, Mar 28, 09:00 PM",
         "Sat, Oct 24, 08:30 PM", "Sat, Oct 24, 09:30 PM"],
        "1,234.5\u202f°C", "problem",
    ),
    ("en-GB", "Australia/Adelaide"): (  # half an hour from the others, and its summer is their winter
        ["Sun 8 Mar, 17:29", "Sun 8 Mar, 17:30", "Sun 29 Mar, 11:29", "Sun 29 Mar, 11:30",
         "Sun 25 Oct, 11:00", "Sun 25 Oct, 12:00"],
        "1,234.5\u202f°C", "problem",
    ),
}  # fmt: skip
"""Locale and zone: each of CHANGES as people there write it; a number; what a problem is called."""


def test_times_and_numbers_are_those_of_the_place_where_the_browser_is(tmp_path: Path) -> None:
    settings = tmp_path / "web.toml"
    settings.write_text(MILL_SETTINGS, encoding="utf-8")
    with page_rig() as rig:
        gateway = played_mill(rig, settings)
        gateway.say("reading/spindle_rear " + json.dumps({"value": 1234.5}))
        for at in CHANGES:
            gateway.say("event " + json.dumps({"text": f"clock of {at}", "kind": "problem", "time": at}))
        for (locale, zone), (times, number, kind) in PLACES.items():
            with rig.page("/machine/mill", locale=locale, zone=zone) as page:
                page.select_option("#event-kind", "")
                page.fill("#event-text", "clock of")
                rows = page.locator("#events tbody tr")
                expect(rows).to_have_count(len(CHANGES))
                told = [text.replace("\u202f", " ") for text in reversed(rows.locator(".when").all_inner_texts())]
                assert told == times, locale
                expect(rows.first.locator(".kind")).to_have_text(kind)
                hot = page.locator("#channels li", has_text="spindle_rear").locator(".number")
                expect(hot).to_have_text(number)
                expect(page.locator("#report")).to_have_attribute("href", re.compile(quote(zone, safe="") + "(&|$)"))
