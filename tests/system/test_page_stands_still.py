"""Nothing on the page for operators moves.

It stands still while it is opened, and with a measurement, another verdict, an order or a failure.
"""

import json
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import pytest
from playwright.sync_api import Route, expect

from gateway.model.text import texts
from tests.benches.page_rig import LIMIT_MS, SCREENS, open_screen, page_rig, played_mill, ports
from tests.benches.page_shifts import TWO_FRAMES, note_shifts, shifts, top_of, tops
from tests.benches.played_telemetry import recorded

pytestmark = [pytest.mark.peer, pytest.mark.slow]

expect.set_options(timeout=LIMIT_MS)
VIEWS = [(*SCREENS[0], "en"), (*SCREENS[-1], "de")]
"""The widest screen, and the narrowest with the longer words."""


@pytest.mark.parametrize(("width", "height"), [SCREENS[-1]])
def test_nothing_moves_while_the_page_and_its_weekly_tables_arrive(settings: Path, width: int, height: int) -> None:
    with page_rig() as rig:
        played_mill(rig, settings)
        with rig.page("/?all=1", width, height) as page:
            held = list[Route]()
            for address in ("**/scatter/*", "**/sensitivity/*"):
                page.route(address, lambda route: held.append(route))
            with page.expect_request("**/scatter/*"), page.expect_request("**/sensitivity/*"):
                page.goto(rig.address.rstrip("/") + "/machine/mill")
            expect(page.locator("#axes .bar").first).to_be_attached()
            note_shifts(page)
            assert shifts(page) == [], "while the page was opened"
            open_screen(page, "log")
            shifts(page)
            below = top_of(page, "#sensitivity-title")
            for each in held:
                each.continue_()
            expect(page.locator("#weeks tbody tr").first).to_be_visible()
            expect(page.locator("#sensitivity tbody tr").first).to_be_attached()
            assert shifts(page) == []
            assert top_of(page, "#sensitivity-title") == below


def test_what_comes_and_goes_with_a_measurement_moves_nothing_below_it(settings: Path) -> None:
    with page_rig() as rig:
        gateway = played_mill(rig, settings)
        with rig.page("/machine/mill", 390, 844) as page:
            waits = page.locator("#helps")
            below = top_of(page, "#strip")
            for reason in ("the door is open", ""):
                gateway.say(
                    "probing " + json.dumps({"reason": reason, "operator": reason, "rejected": 3 * bool(reason)})
                )
                if reason:
                    expect(waits).to_contain_text(reason)
                    assert top_of(page, "#strip") == below
            expect(waits).not_to_contain_text("the door is open")
            assert top_of(page, "#strip") == below
            height = "document.getElementById('ready').offsetHeight"
            page.set_viewport_size({"width": 1400, "height": 900})
            page.evaluate(TWO_FRAMES)
            turned = page.evaluate(height)
            page.reload()
            expect(page.locator("#axes .bar").first).to_be_attached()
            page.evaluate(TWO_FRAMES)
            assert turned == page.evaluate(height)


ESTIMATE = dict(recorded())["decision"]
VERDICTS = (
    ("probing", {"standing": "asked"}, "word.unsure"),
    ("status", {"nc": "probing"}, "word.probing"),
    ("probing", {"standing": "not_wanted"}, "word.unsure"),
    ("decision", {"phase": "no_good"}, "word.not_ready"),
    ("decision", {"phase": "compensation", "corrected": {}}, "word.unknown"),
    ("decision", {"corrected": ESTIMATE["corrected"]}, "word.unsure"),
)


def test_another_verdict_moves_nothing(settings: Path) -> None:
    with page_rig() as rig, ExitStack() as opened:
        gateway = played_mill(rig, settings)
        pages = {
            of: opened.enter_context(rig.page(f"/machine/mill?lang={of}", width, height, locale=f"{of}-CH"))
            for width, height, of in VIEWS
        }
        below = dict[str, list[float]]()

        def stands_still(verdict: str) -> None:
            for language, page in pages.items():
                expect(page.locator("#word")).to_have_text(texts(language)[verdict])
                assert (shifts(page), tops(page)) == ([], below[language]), verdict

        gateway.say("status " + json.dumps({"unarmed": ["nothing will be learnt: probing is not armed"]}))
        for language, page in pages.items():
            expect(page.locator("#axes .bar").first).to_be_attached()
            expect(page.locator("#unarmed")).to_be_visible()
            page.fill("input[name=tolerance]", "3")
            page.keyboard.press("Enter")
            expect(page.locator("#word")).to_have_text(texts(language)["word.unsure"])
            expect(page.locator("#helps p").nth(5)).to_be_attached()
            note_shifts(page)
            shifts(page)
            below[language] = tops(page)
        for key, changes, verdict in VERDICTS:
            gateway.say(f"{key} {json.dumps(changes)}")
            stands_still(verdict)
        gateway.kill()
        stands_still("word.gone")
        assert rig.web is not None
        rig.web.kill()
        stands_still("word.lost")


_BY = {"by": "maintenance", "since": "2026-03-02T22:58:00+00:00"}
_CONTROL = dict(recorded())["compensation"]


@dataclass(frozen=True)
class Occurrence:
    """What happens to a gateway or its machine."""

    what: str
    """What the event says."""
    changes: dict[str, dict[str, object]]
    """The changes by key, in its last message."""
    orders: int = 0
    """The orders that then stand."""


def stands(**orders: object) -> dict[str, object]:
    """The status, with what the gateway then waits for."""
    return orders | {"waits_for": [f"somebody to end it: {each} by maintenance" for each, by in orders.items() if by]}


OCCURRENCES = (
    Occurrence("paused", {"status": stands(paused=_BY), "compensation": {"source": "paused"}}, orders=1),
    Occurrence("disarmed too", {"status": stands(paused=_BY, disarmed=_BY), "compensation": {"source": "disarmed"}}, 2),
    Occurrence("armed", {"status": stands(paused=_BY, disarmed=None), "compensation": {"source": "paused"}}, orders=1),
    Occurrence("resumed", {"status": stands(paused=None), "compensation": {"source": _CONTROL["source"]}}),
    Occurrence(
        "a sensor fails",
        {
            "reading/ambient_left": {"quality": "comm_fault", "value": None},
            "status": {"waits_for": ["channel ambient_left: comm_fault: no answer"], "channels_good": 29},
        },
    ),
    Occurrence(
        "the sensor is back",
        {"reading/ambient_left": {"quality": "good", "value": 25.0}, "status": {"waits_for": [], "channels_good": 30}},
    ),
    Occurrence(
        "the control goes",
        {
            "status": {"nc": "away", "waits_for": ["the control: it cannot be reached"]},
            "compensation": {"source": "unanswered", "written": False},
            "probing": {"standing": "blocked", "reason": "the control does not answer", "operator": "check its cable"},
        },
    ),
    Occurrence(
        "the control is back",
        {
            "status": {"nc": "ready", "waits_for": []},
            "compensation": {"source": _CONTROL["source"], "written": True},
            "probing": {"standing": "not_wanted", "reason": "", "operator": ""},
        },
    ),
)


@pytest.mark.parametrize(("width", "height", "language"), VIEWS)
def test_orders_failures_and_returns_move_nothing(settings: Path, width: int, height: int, language: str) -> None:
    said = texts(language)
    with page_rig() as rig:
        (port,) = ports(1)
        gateway = rig.gateway(port, "mill")
        rig.serve([port], settings)
        with rig.page(f"/machine/mill?lang={language}", width, height, locale=f"{language}-CH") as page:
            word, latest = page.locator("#word"), page.locator("#events tbody tr").first
            expect(word).to_have_text(said["word.no_data"])  # it listens
            gateway.say("")
            expect(page.locator("#axes .bar").first).to_be_attached()
            expect(page.locator("#corrections tbody tr").first).to_be_attached()
            note_shifts(page)
            shifts(page)
            below = tops(page)
            for each in OCCURRENCES:
                for key, changes in each.changes.items():
                    gateway.say(f"{key} {json.dumps(changes)}")
                gateway.say("event " + json.dumps({"kind": "problem", "text": f"It happens: {each.what}"}))
                expect(latest).to_contain_text(f"It happens: {each.what}")
                expect(page.locator("#notices p")).to_have_count(each.orders)
                expect(page.locator("#channels .mark")).to_have_count(int(each.what == "a sensor fails"))
                nc = "nc.away" if each.what == "the control goes" else "nc.ready"
                expect(page.locator("#health")).to_contain_text(said[nc])
                assert (shifts(page), tops(page)) == ([], below), each.what
            gateway.kill()
            expect(word).to_have_text(said["word.gone"])
            assert (shifts(page), tops(page)) == ([], below), "the gateway is gone"
            back = rig.gateway(port, "mill")
            expect(word).to_have_text(said["word.no_data"])
            assert (shifts(page), tops(page)) == ([], below), "the gateway is back"
            back.say("")
            expect(word).not_to_have_text(said["word.no_data"])
            expect(page.locator("#health")).to_contain_text(said["nc.ready"])
            expect(page.locator("#drives .stack").first).to_be_attached()
            assert (shifts(page), tops(page)) == ([], below), "the gateway has said everything again"
