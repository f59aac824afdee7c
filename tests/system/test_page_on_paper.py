"""The page for operators on paper: whole, on a few sheets, with the latest of its long lists."""

import json
import re
from datetime import UTC, datetime
from pathlib import Path

import pytest
from playwright.sync_api import expect

from tests.benches.page_rig import LIMIT_MS, MILL_SETTINGS, page_rig, played_mill
from tests.benches.paper import cut_off, left_alone, printed, printed_texts, torn

pytestmark = [pytest.mark.peer, pytest.mark.slow]

MOST_SHEETS = 6
EVENTS, EVENTS_PRINTED, CORRECTIONS_PRINTED = 60, 20, 10
PROBLEM = "bus can1, device fluids: node 5: no answer within 0.5 s (check power, termination, node id and bitrate)"

expect.set_options(timeout=LIMIT_MS)


def zone_at(hour: int) -> str:
    """A time zone in which it is this hour now."""
    east = (hour - datetime.now(UTC).hour + 12) % 24 - 12
    return f"Etc/GMT{-east:+d}" if east else "Etc/GMT"


@pytest.mark.parametrize("hour", [0, 12], ids=["after midnight, as times of the day before have a date", "noon"])
@pytest.mark.parametrize(("language", "left_out"), [("en", "{} earlier lines"), ("de", "{} frühere Zeilen")])
def test_the_page_prints_whole_and_says_how_many_lines_it_leaves_out(
    tmp_path: Path, language: str, left_out: str, hour: int
) -> None:
    settings = tmp_path / "web.toml"
    settings.write_text(MILL_SETTINGS, encoding="utf-8")
    with page_rig() as rig:
        gateway = played_mill(rig, settings)
        for n in range(EVENTS):
            gateway.say("event " + json.dumps({"kind": "problem", "text": f"{PROBLEM}, {n + 1}"}))
        with rig.page(f"/machine/mill?lang={language}", dark=True, locale=f"{language}-CH", zone=zone_at(hour)) as page:
            expect(page.locator("#axes .u-over")).to_have_count(3)
            expect(page.locator("#weeks tbody tr").first).to_be_attached()
            expect(page.locator("#sensitivity tbody tr").first).to_be_attached()
            expect(page.locator("#events tbody tr").first).to_contain_text(f"{PROBLEM}, {EVENTS}")
            events, corrections = (page.locator(f"#{name} tbody tr").count() for name in ("events", "corrections"))
            assert events >= EVENTS
            assert corrections > CORRECTIONS_PRINTED
            page.emulate_media(media="print")
            rows, headings = printed_texts(page, "tbody tr"), printed_texts(page, "h2, h3, thead tr")
            latest = printed_texts(page, "#events tbody tr")
            assert len(latest) == EVENTS_PRINTED
            assert PROBLEM in latest[0]
            assert len(printed_texts(page, "#corrections tbody tr")) == CORRECTIONS_PRINTED
            told = "\n".join(printed_texts(page, "p"))
            assert left_out.format(events - EVENTS_PRINTED) in told
            assert left_out.format(corrections - CORRECTIONS_PRINTED) in told
            assert re.search(r"(State of|Stand von) \w+, \d.* 20\d\d", told), "the day, for whoever finds the sheet"
            for paper in ("A4", "Letter"):
                sheets = printed(page, tmp_path, paper)
                assert len(sheets) <= MOST_SHEETS
                assert (cut_off(sheets), torn(rows, sheets), left_alone(headings, sheets)) == ([], [], [])
