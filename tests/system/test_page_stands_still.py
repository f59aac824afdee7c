"""Nothing on the page for operators moves: not while it is opened, nor with a measurement, nor with another verdict."""

import json
from pathlib import Path

import pytest
from playwright.sync_api import Route, expect

from gateway.web.catalogue import LANGUAGES, texts
from tests.benches.page_rig import LIMIT_MS, MILL_SETTINGS, SCREENS, page_rig, played_mill
from tests.benches.page_shifts import TWO_FRAMES, note_shifts, shifts, top_of, tops
from tests.benches.played_telemetry import recorded

pytestmark = [pytest.mark.peer, pytest.mark.slow]

expect.set_options(timeout=LIMIT_MS)


@pytest.fixture
def settings(tmp_path: Path) -> Path:
    file = tmp_path / "web.toml"
    file.write_text(MILL_SETTINGS, encoding="utf-8")
    return file


@pytest.mark.parametrize(("width", "height"), SCREENS)
def test_nothing_moves_while_the_page_and_its_weekly_tables_arrive(settings: Path, width: int, height: int) -> None:
    with page_rig() as rig:
        played_mill(rig, settings)
        with rig.page("/?all=1", width, height) as page:
            held = list[Route]()
            for address in ("**/scatter/*", "**/sensitivity/*"):
                page.route(address, lambda route: held.append(route))
            with page.expect_request("**/scatter/*"), page.expect_request("**/sensitivity/*"):
                page.goto(rig.address.rstrip("/") + "/machine/mill")
            expect(page.locator("#axes .u-over")).to_have_count(3)
            note_shifts(page)
            assert shifts(page) == [], "while the page was opened"
            page.evaluate("document.getElementById('health-title').scrollIntoView()")
            shifts(page)
            below = top_of(page, "#events-title")
            for each in held:
                each.continue_()
            expect(page.locator("#weeks tbody tr").first).to_be_visible()
            expect(page.locator("#sensitivity tbody tr").first).to_be_attached()
            assert shifts(page) == []
            assert top_of(page, "#events-title") == below


def test_what_comes_and_goes_with_a_measurement_moves_nothing_below_it(settings: Path) -> None:
    with page_rig() as rig:
        gateway = played_mill(rig, settings)
        with rig.page("/machine/mill", 390, 844) as page:
            waits = page.locator("#waits")
            for reason in ("the door is open", ""):
                gateway.say(
                    "probing " + json.dumps({"reason": reason, "operator": reason, "rejected": 3 * bool(reason)})
                )
                if reason:
                    expect(waits).to_contain_text(reason)
                    below = top_of(page, "#heat-title")
            expect(waits).not_to_contain_text("the door is open")
            assert top_of(page, "#heat-title") == below
            page.set_viewport_size({"width": 1400, "height": 900})
            page.evaluate(TWO_FRAMES)
            assert page.evaluate("document.getElementById('ready').offsetHeight") < 400, "not that of the phone"


@pytest.mark.parametrize(("width", "height"), SCREENS)
def test_the_first_forecast_moves_nothing(settings: Path, width: int, height: int) -> None:
    """Nor do the lines that it says of planned loads: the status has named them."""
    with page_rig() as rig:
        gateway = played_mill(rig, settings)
        gateway.say("status " + json.dumps({"planned_loads": ["warm-up", "roughing of a housing"]}))
        with rig.page("/machine/mill", width, height) as page:
            expect(page.locator("#axes .u-over")).to_have_count(3)
            expect(page.locator("#weeks")).to_be_visible()
            expect(page.locator("#sensitivity")).to_be_visible()
            expect(page.locator("#planned-room > *")).to_have_count(2)
            page.evaluate("scrollTo(0, 0)")
            note_shifts(page)
            shifts(page)
            below = tops(page)
            gateway.say("forecast " + json.dumps({"planned": {"warm-up": {}, "roughing of a housing": {}}}))
            expect(page.locator("#helps")).to_contain_text("roughing of a housing")
            assert (shifts(page), tops(page)) == ([], below)


ESTIMATE = dict(recorded())["decision"]
VERDICTS = (
    ("probing", {"standing": "asked"}, "word.probing"),
    ("probing", {"standing": "not_wanted"}, "word.unsure"),
    ("decision", {"phase": "no_good"}, "word.not_ready"),
    ("decision", {"phase": "compensation", "corrected": {}}, "word.unknown"),
    ("decision", {"corrected": ESTIMATE["corrected"]}, "word.unsure"),
)
"""Key, what changes in its last message, and the verdict."""


@pytest.mark.parametrize("language", LANGUAGES)
@pytest.mark.parametrize(("width", "height"), SCREENS)
def test_another_verdict_moves_nothing(settings: Path, width: int, height: int, language: str) -> None:
    with page_rig() as rig:
        gateway = played_mill(rig, settings)
        said = texts(language)
        with rig.page(f"/machine/mill?lang={language}", width, height, locale=f"{language}-CH") as page:
            word = page.locator("#word")
            expect(page.locator("#axes .u-over")).to_have_count(3)
            expect(page.locator("#weeks")).to_be_visible()
            expect(page.locator("#sensitivity")).to_be_visible()
            page.fill("input[name=tolerance]", "3")
            page.keyboard.press("Enter")
            expect(word).to_have_text(said["word.unsure"])
            expect(page.locator("#helps p").nth(5)).to_be_attached()
            gateway.say("status " + json.dumps({"unarmed": ["nothing will be learnt: probing is not armed"]}))
            expect(
                page.locator("#notices p")
            ).to_be_visible()  # what is not armed is not said of a gateway that is gone
            page.evaluate("scrollTo(0, 0)")
            note_shifts(page)
            shifts(page)
            below = tops(page)
            for key, changes, verdict in VERDICTS:
                gateway.say(f"{key} {json.dumps(changes)}")
                expect(word).to_have_text(said[verdict])
                assert (shifts(page), tops(page)) == ([], below), verdict
            gateway.kill()
            expect(word).to_have_text(said["word.gone"])
            assert (shifts(page), tops(page)) == ([], below)
            assert rig.web is not None
            rig.web.kill()
            expect(word).to_have_text(said["word.lost"])
            assert (shifts(page), tops(page)) == ([], below)
