"""The page for operators on a panel of 10 inches and 1024 × 600, read from two metres."""

import json
import math
import re
from contextlib import ExitStack
from pathlib import Path

import pytest
from playwright.sync_api import Locator, expect

from gateway.model.text import languages, texts
from tests.benches.page_rig import LIMIT_MS, open_screen, page_rig, played_mill

pytestmark = [pytest.mark.peer, pytest.mark.slow]

WIDTH, HEIGHT = 1024, 600
MM_PER_PIXEL = 10.0 * 25.4 / math.hypot(WIDTH, HEIGHT)
AWAY_MM = 2000.0
LEGIBLE = 16.0
"""Minutes of arc: the least height of a capital letter that ISO 9241-303 allows."""
ACUITY = 5.0
"""Minutes of arc: the height of a letter that a person with normal sight (6/6, ISO 8596) can just read."""

_CAPITAL = """(element) => {
  const canvas = document.createElement("canvas").getContext("2d"), style = getComputedStyle(element);
  canvas.font = `${style.fontWeight} ${style.fontSize} ${style.fontFamily}`;
  return canvas.measureText("H").actualBoundingBoxAscent;
}"""

_CUT = """() => [["#word", "Width"], ["#because", "Height"], [".inside", "Height"]].filter(([name, of]) => {
  const place = document.querySelector(name);
  return place["scroll" + of] > place["client" + of];
}).map(String)"""
"""The parts whose texts do not fit."""

expect.set_options(timeout=LIMIT_MS)


def minutes_of_arc(place: Locator) -> float:
    """Height of a capital letter from two metres."""
    height_mm = place.evaluate(_CAPITAL) * MM_PER_PIXEL
    return 60.0 * math.degrees(math.atan(height_mm / AWAY_MM))


def test_the_verdict_its_reason_and_the_numbers_are_read_from_two_metres(settings: Path) -> None:
    with page_rig() as rig, ExitStack() as opened:
        gateway = played_mill(rig, settings)
        pages = {
            of: opened.enter_context(rig.page(f"/machine/mill?lang={of}", WIDTH, HEIGHT, locale=f"{of}-CH"))
            for of in languages()
        }
        for page in pages.values():
            expect(page.locator("#because p").first).to_be_visible()
            assert minutes_of_arc(page.locator("#word").first) >= LEGIBLE
            assert minutes_of_arc(page.locator("#because p").first) >= 1.3 * ACUITY
            assert minutes_of_arc(page.locator("#axes .number").first) >= 1.3 * ACUITY
            assert page.evaluate(_CUT) == []
            expect(page.locator("#most")).to_contain_text(
                re.compile(r"\d:\d\d.+\bX.+\(.+\d\), Y.+\(.+\d\), Z.+\(.+\d\)")
            )
            expect(page.locator("#most")).to_be_in_viewport(ratio=1.0)
        gateway.say("status " + json.dumps({"clock": "simulated"}))
        for page in pages.values():
            open_screen(page, "time")
            for seen in ("#heard b", "#badge a"):
                expect(page.locator(seen)).to_be_in_viewport(ratio=1.0)
            open_screen(page, "now")
        gateway.say("status " + json.dumps({"clock": "system"}))
        gateway.say("reading/ambient_left " + json.dumps({"quality": "sensor_fault", "value": None}))
        for changes, verdict in (({"phase": "no_good"}, "word.not_ready"), ({"corrected": {}}, "word.unknown")):
            gateway.say("decision " + json.dumps({"phase": "compensation"} | changes))
            for language, page in pages.items():
                expect(page.locator("#word")).to_have_text(texts(language)[verdict])
                for seen in ("#word", "#because", "#helps p", "[data-of=half]"):
                    expect(page.locator(seen).first).to_be_in_viewport(ratio=1.0)
                expect(page.locator("#failed")).not_to_be_empty()
                assert page.evaluate(_CUT) == [], (language, verdict)
                assert minutes_of_arc(page.locator("#helps p").first) >= 1.3 * ACUITY, "when it will be ready"
        for page in pages.values():
            usual = [minutes_of_arc(page.locator(each).first) for each in ("#word", "#because p", "#axes .number")]
            page.goto(page.url.partition("#")[0] + "&panel")
            expect(page.locator("#rail")).to_be_hidden()
            expect(page.locator("#axes .number").first).to_be_visible()
            for each, before in zip(("#word", "#because p", "#axes .number"), usual, strict=True):
                assert minutes_of_arc(page.locator(each).first) > before, each
            assert page.evaluate(_CUT) == []
            for seen in ("#word", "#because", "#axes article:last-child .number", "#sketch", "#helps p", "#strip"):
                expect(page.locator(seen).first).to_be_in_viewport(ratio=1.0)
