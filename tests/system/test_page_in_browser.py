"""The page for operators as a browser shows it: live telemetry of the demo's machine, and gateways that go and come.

The pictures go to out/page or to the folder PAGE_PICTURES: `make pictures` puts them in docs.
"""

import json
import os
import re
import signal
from io import BytesIO
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import pytest
from PIL import Image
from playwright.sync_api import Page, Response, Route, expect

from gateway.model.text import texts
from gateway.runtime.passwords import make_hash
from tests.benches.axe import violations
from tests.benches.page_rig import (
    LIMIT_MS,
    SCREENS,
    PageRig,
    expect_each_part,
    open_screen,
    page_rig,
    played_mill,
    ports,
)
from tests.benches.printed_pages import printed

pytestmark = [pytest.mark.peer, pytest.mark.slow]

PICTURES = Path(os.environ.get("PAGE_PICTURES", Path(__file__).parents[2] / "out" / "page"))

expect.set_options(timeout=LIMIT_MS)


def picture(page: Page, name: str, *, whole: bool = False) -> None:
    """A small file of what is seen, or of the whole page; no two parts get one colour."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    with Image.open(BytesIO(page.screenshot(full_page=whole))) as shown:
        shown.quantize(256, dither=Image.Dither.NONE).save(PICTURES / f"{name}.png", optimize=True)


def widest(page: Page) -> int:
    return int(page.evaluate("document.documentElement.scrollWidth"))


def test_each_part_shows_live_data(settings: Path) -> None:
    with page_rig() as rig:
        gateway = played_mill(rig, settings)
        for width, height in SCREENS:
            for dark in (False, True):
                with rig.page("/machine/mill", width, height, dark=dark) as page:
                    expect(page.locator("#axes .bar").first).to_be_attached()
                    expect(page.locator("#word")).to_have_text(re.compile("^(Ready|Not sure|Not ready)$"))
                    for seen in ("#word", "#because p", "#axes article:last-child .number", "#sketch"):
                        expect(page.locator(seen).first).to_be_in_viewport(ratio=1.0)
                    moves = "#now-why" if width == SCREENS[0][0] else ".each-moved:visible"
                    expect(page.locator(moves)).to_contain_text("spindle")
                    expect(page.locator(moves)).to_be_in_viewport(ratio=1.0)
                    assert widest(page) <= width
                    picture(page, f"page-{width}-{'dark' if dark else 'light'}")
        with rig.page("/machine/mill") as page:
            expect_each_part(page)
            expect(page.locator("#price dd")).not_to_be_empty()
            expect(page.locator("#corrections tbody tr").first).to_contain_text("chosen inputs")
            lines = page.locator("#corrections tbody tr").count()
            open_screen(page, "why")
            page.select_option("#correction-error", "EZ0A")
            expect(page.locator("#corrections tbody tr").first).to_contain_text("spindle_rear")
            assert 0 < page.locator("#corrections tbody tr").count() < lines
            open_screen(page, "log")
            expect(page.locator("#health")).to_contain_text("Scatter of the touches")
            expect(page.locator("#weeks")).to_be_visible()
            expect(page.locator("#weeks tbody tr").first).to_contain_text("0.4")
            driven = page.locator("#sensitivity tbody tr")
            expect(driven).to_have_count(1)
            # A week of which there are less than two hours has no slope.
            expect(driven).to_have_text(re.compile("spindle_rear–?[+]4.00\u202fµm/K([+]4.00|–)?100\u202f%$"))
            expect(driven.locator("th")).to_have_text("EZ0A position of the A axis in Z")
            page.fill("#event-text", "nothing has this text")
            expect(page.locator("#events-empty")).to_have_text("No event matches the filter.")
            open_screen(page, "sensors")
            picture(page, "page-sensors")
            open_screen(page, "why")
            expect(page.locator("#day-parts tbody tr").first).to_be_visible()
            expect(page.locator("#day-axes svg")).to_have_count(3)
            picture(page, "page-why")
            open_screen(page, "now")
            x, cradle = page.locator("input[name=x]"), page.locator("#sketch [data-part=cradle]")
            expect(x).to_have_value("200")  # as declared for a gateway that does not tell its sphere and its axes
            expect(cradle).to_have_count(3)
            gateway.say("status " + json.dumps({"sphere_mm": [150.0, 80.0], "kinematics": "w-C'-X'-b-Y-Z-t"}))
            expect(x).to_have_value("150")
            expect(cradle).to_have_count(0)
            gateway.say("status " + json.dumps({"sphere_mm": [200.0, 80.0], "kinematics": ""}))
            expect(cradle).to_have_count(3)
            page.fill("input[name=tolerance]", "3")
            page.keyboard.press("Enter")
            expect(page.locator("#word")).to_have_text("Not sure")
            expect(page.locator("#helps")).to_contain_text(texts("en")["when.not_before"].split("{")[0])
            for what in ("wait 30 min", "measure now", "warm up with spindle and axes"):
                expect(page.locator("#helps")).to_contain_text(f"If you {what}")
            gateway.say("forecast " + json.dumps({"planned": {"<b>warm-up": {}}}))
            expect(page.locator("#helps")).to_contain_text("Under “<b>warm-up”: not known yet.")


_BROKEN = """() => {
  const found = [], range = document.createRange();
  const nodes = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let node; (node = nodes.nextNode());) {
    if (node.parentNode.closest(".quiet")) continue;
    for (const word of node.data.matchAll(/[\\p{L}\\p{N}_]{2,}/gu)) {
      range.setStart(node, word.index);
      range.setEnd(node, word.index + word[0].length);
      const tops = [...range.getClientRects()].filter((each) => each.width).map((each) => each.top);
      if (Math.max(...tops) - Math.min(...tops) > 4) found.push(word[0]);
    }
  }
  return found;
}"""
"""Words of which a part is on the next line."""


@pytest.mark.parametrize("language", ["en", "de"])
def test_no_word_is_broken_on_any_screen(looked_at: PageRig, language: str) -> None:
    for width, height in SCREENS[1:]:
        with looked_at.page(f"/machine/mill?lang={language}", width, height, locale=f"{language}-CH") as page:
            expect(page.locator("#axes .bar").first).to_be_attached()
            for screen in ("now", "time", "why", "sensors", "log"):
                open_screen(page, screen)
                expect(page.locator(f"#{screen}")).to_be_visible()
                assert page.evaluate(_BROKEN) == [], (width, screen)
            page.set_viewport_size({"width": 60, "height": height})
            assert page.evaluate(_BROKEN) != [], "it would be seen"


def past_days(answer: Response) -> float:
    """How much of the past was asked for; 0: it answers something else."""
    address = urlsplit(answer.url)
    if address.path != "/past/mill":
        return 0.0
    asked = parse_qs(address.query)
    return (float(asked["to"][0]) - float(asked["from"][0])) / 86400.0


def asked_span(answer: Response) -> tuple[float, float]:
    """The past that was asked for, UTC seconds."""
    asked = parse_qs(urlsplit(answer.url).query)
    return float(asked["from"][0]), float(asked["to"][0])


def test_an_opened_page_shows_what_the_gateway_has_stored_of_before(looked_at: PageRig) -> None:
    with looked_at.page("/machine/mill#time") as page:
        expect(page.locator("#chart .u-over")).to_have_count(1)
        held: list[Route] = []
        page.route("**/past/mill?*", lambda route: held.append(route), times=1)
        page.select_option("#span", "168")
        with page.expect_response(lambda answer: past_days(answer) > 25.0) as answered:
            page.select_option("#span", "720")
        assert answered.value.ok
        assert len(answered.value.json()["t"]) == 500
        expect(page.locator("#past-problem")).to_be_empty()
        expect(page.locator("#stored-since")).not_to_be_empty()
        with page.expect_response(lambda answer: 5.0 < past_days(answer) < 10.0):
            held[0].continue_()  # the answer to what is no longer asked comes last
        over = page.locator("#chart .u-over")
        box = over.bounding_box()
        assert box is not None
        over.hover(position={"x": 5, "y": 40})
        expect(page.locator("#reading")).not_to_contain_text("without")
        over.hover(position={"x": 0.9 * box["width"], "y": 40})
        expect(page.locator("#reading")).to_contain_text("without")
        expect(page.locator("#stored-since")).not_to_be_empty()
        picture(page, "page-month")
        with page.expect_response(lambda answer: 0.0 < past_days(answer) < 25.0) as finer:
            page.mouse.move(box["x"] + 0.80 * box["width"], box["y"] + 40)  # seven of thirty days are stored
            page.mouse.down()
            page.mouse.move(box["x"] + 0.95 * box["width"], box["y"] + 40, steps=5)
            page.mouse.up()
        assert finer.value.json()["t"][-1] - finer.value.json()["t"][0] < 30 * 86400
        shown = asked_span(finer.value)
        with page.expect_response(lambda answer: 0.0 < past_days(answer) < 25.0) as earlier:
            page.mouse.wheel(-box["width"] / 2, 0.0)
        began, ended = asked_span(earlier.value)
        assert ended - began == pytest.approx(shown[1] - shown[0], rel=0.01)
        assert began - shown[0] == pytest.approx(0.5 * (began - ended), rel=0.01), "half a chart back"


def test_what_others_name_stays_a_name_and_a_failing_sensor_is_seen(settings: Path) -> None:
    with page_rig() as rig:
        gateway = played_mill(rig, settings)
        with rig.page("/machine/mill") as page:
            forged = "<script>document.title='forged'</script>"
            name = "<img src=x onerror=alert(1)>"
            gateway.say("event " + json.dumps({"text": forged, "kind": "problem"}))
            gateway.say("reading/ambient_left " + json.dumps({"quality": "sensor_fault", "value": None}))
            gateway.say("reading/forged " + json.dumps({"channel": name, "value": 1.0}))
            expect(page.locator("#events tbody tr").first).to_contain_text(forged)
            expect(page.locator("#channels li")).to_have_count(31)
            expect(page.locator("#channels")).to_contain_text(name)
            expect(page.locator("#channels li").first).to_contain_text(re.compile(r"ambient_left\s+sensor fault"))
            expect(page.locator("#doubts")).to_contain_text("No good value: ambient_left")
            assert page.locator("#channels img").count() == 0
            assert "forged" not in page.title()


def test_the_report_of_a_day_opens_in_a_sandbox_in_which_its_charts_still_work(looked_at: PageRig) -> None:
    with looked_at.page("/machine/mill#log") as page:
        expect(page.locator("#report")).to_have_attribute("href", re.compile(r"/mill/report/\d{4}-\d\d-\d\d\?zone="))
        page.fill("#report-day", "2026-03-02")
        expect(page.locator("#report")).to_have_attribute(
            "href", "/machine/mill/report/2026-03-02?zone=Europe%2FZurich&lang=en&tolerance=8"
        )
        said = list[str]()
        page.context.on("console", lambda message: said.append(message.text))
        page.context.on("weberror", lambda error: said.append(str(error.error)))
        with page.context.expect_page() as opened:
            page.click("#report")
        report = opened.value
        expect(report.locator("h1")).to_contain_text("at the tool: 40 → 4")
        expect(report.locator(".live .u-over").first).to_be_attached()
        report.click("#time button[name=closer]")
        assert said == []
        assert report.evaluate("window.origin") == "null", "not of the page's origin"
        assert report.evaluate("fetch('/').then(() => 'reached', () => 'refused')") == "refused"


def test_the_tolerance_and_the_point_are_this_browsers_and_the_keyboard_is_enough(looked_at: PageRig) -> None:
    with looked_at.page("/machine/mill") as page:
        expect(page.locator("input[name=tolerance]")).to_have_value("8")
        page.keyboard.press("Tab")
        assert page.evaluate("document.activeElement.className") == "skip"
        page.focus("input[name=tolerance]")
        page.keyboard.press("Control+A")
        page.keyboard.type("1000")
        page.keyboard.press("Enter")
        expect(page.locator("#word")).to_have_text("Ready")
        page.reload()
        expect(page.locator("#word")).to_have_text("Ready")
        expect(page.locator("#axes [data-axis=Y] [data-of=half]")).not_to_have_text("–")
        before = page.locator("#axes [data-axis=Y] [data-of=half]").inner_text()
        open_screen(page, "why")
        page.click("summary")
        page.fill("input[name=x]", "0")
        page.click("button[type=submit]")
        expect(page.locator("#axes [data-axis=Y] [data-of=half]")).not_to_have_text("–")
        page.click("button[type=reset]")
        expect(page.locator("input[name=tolerance]")).to_have_value("8")
        expect(page.locator("#axes [data-axis=Y] [data-of=half]")).to_have_text(before)
    with looked_at.page("/machine/mill", locale="de-DE") as page:
        expect(page.locator("#waits-title")).to_have_text(texts("de")["part.waits"])
        expect(page.locator("#axes [data-axis=Y] [data-of=half]")).to_have_text(before.replace(".", ","))
        page.emulate_media(media="print")
        expect(page.locator("form")).to_be_hidden()
        expect(page.locator("#chart .u-over")).to_have_count(1)
        for each in ("#axes", "#drives", "#channels", "#events-title"):
            expect(page.locator(each)).to_be_visible()
        page.evaluate("document.getElementById('main').style.width = '600px'")  # paper is narrower than a screen
        inside = """() => {
          const chart = document.getElementById('chart'), wide = (e) => e.getBoundingClientRect().width;
          return wide(chart.querySelector('canvas')) <= wide(chart); }"""
        assert page.evaluate(inside)


@pytest.mark.parametrize("width", [1400, 390])
def test_paper_has_each_part_of_a_page_of_which_one_screen_was_seen(
    looked_at: PageRig, tmp_path: Path, width: int
) -> None:
    with looked_at.page("/machine/mill", width) as page:
        for each in ("#day-parts th i", "#weeks tbody th", "#sensitivity tbody th", "#channels .spark path"):
            expect(page.locator(each).first).to_be_attached()
        stored = page.locator("#day-parts tbody th, #weeks tbody th, #sensitivity tbody th")
        wanted = [name.split()[0] for name in stored.all_text_contents()]
        page.pdf(path=tmp_path / "page.pdf", format="A4")
    pages = printed(tmp_path / "page.pdf")
    assert all(page.strip() for page in pages), "none is blank"
    titles = ("part.waits", "scenario.title", "moves.day", "moves.errors", "part.corrections", "part.events",
              "part.health", "weeks.title", "sensitivity.title")  # fmt: skip
    wanted += ["Z, µm", *(texts("en")[key] for key in titles)]  # the chart's axis
    assert [each for each in wanted if each not in "".join(pages)] == []


def test_a_gateway_that_is_killed_looks_gone_and_one_that_comes_back_begins_again(settings: Path) -> None:
    with page_rig() as rig:
        port, other = ports(2)
        mill, lathe = rig.gateway(port, "mill"), rig.gateway(other, "lathe")
        rig.serve([port, other], settings)
        with rig.page("/machine/mill") as page, rig.page("/?all=1") as machines:
            expect(page.locator("#word")).to_have_text("No data yet")
            for by_week in ("#weeks-empty", "#sensitivity-empty"):
                expect(page.locator(by_week)).to_contain_text("once the gateway has sent a message")
            mill.say("")
            expect(page.locator("#axes .bar").first).to_be_attached()
            lathe.say("")
            expect(machines.locator("li")).to_have_count(2)
            lathe.say("status " + json.dumps({"unarmed": ["nothing will be learnt: probing is not armed"]}))
            expect(machines.locator("li .notice")).to_have_text(
                "Not armed: nothing will be learnt: probing is not armed"
            )
            with rig.page("/machine/lathe#time") as untold:  # nobody has told its tolerance
                expect(untold.locator("#chart .u-over")).to_have_count(1)
            mill.kill()
            expect(page.locator("#word")).to_have_text("Gone")
            expect(page.locator("#ready")).to_have_class("verdict away")
            expect(page.locator("#since")).not_to_be_empty()
            expect(page.locator("[data-axis=Z] [data-of=left]")).to_have_text("–")
            assert page.evaluate("document.body.classList.contains('past')")
            heading, key = page.locator(".strip h3 > .while-past"), page.locator(".strip small .dot").bounding_box()
            expect(heading).to_have_css("overflow", "visible")
            assert key is not None
            assert heading.evaluate("(e) => e.getBoundingClientRect().left + e.scrollWidth") < key["x"]
            picture(page, "page-gone")
            expect(machines.locator("li .name").first).to_have_text("mill")
            assert rig.web is not None
            os.kill(rig.web.pid, signal.SIGSTOP)  # as a network that fails for a while
            expect(page.locator("#word")).to_have_text("No connection")
            expect(page).to_have_title("No connection · mill")
            os.kill(rig.web.pid, signal.SIGCONT)
            expect(page.locator("#word")).to_have_text("Gone")
            rig.gateway(port, "mill", "nothing")
            expect(page.locator("#word")).to_have_text("No data yet")
            rig.web.kill()
            expect(page.locator("#lost")).to_be_visible()
            expect(page.locator("#word")).to_have_text("No connection")
            expect(machines.locator("li .word")).to_have_text(["No connection"] * 2)
            expect(machines.locator("li.away")).to_have_count(2)


def test_nothing_old_looks_fresh(settings: Path) -> None:
    with page_rig() as rig:
        gateway = played_mill(rig, settings)
        assert rig.web is not None
        with rig.page("/machine/mill") as page, rig.page("/?all=1") as machines:
            by = {"by": "anna", "since": "2026-03-02T22:58:00+00:00"}
            gateway.say("status " + json.dumps({"paused": by, "unarmed": ["probing is not armed"]}))
            gateway.say("compensation " + json.dumps({"source": "stale"}))
            fresh = (page.locator("#notices p"), page.locator("#unarmed"))
            coming = page.locator("#strip .coming").first
            """The forecast in the hours ahead."""
            moved, foreseen = page.locator("#now-why .share"), page.locator("#warm .line")
            page.fill("input[name=tolerance]", "3")
            page.keyboard.press("Enter")
            expect(page.locator("#helps p").first).to_be_attached()
            expect(page.locator("#tool-notes p")).to_have_count(1)
            for each in fresh:
                expect(each).to_be_visible()
            expect(page.locator("#since")).not_to_be_empty()
            expect(machines.locator("li .notice")).to_have_count(2)
            expect(page.locator("#axes .bar").first).to_be_attached()
            for each in (coming, moved.first, foreseen.first):
                expect(each).to_be_attached()

            def expect_nothing_fresh(word: str) -> None:
                expect(page.locator("#word")).to_have_text(word)
                expect(machines.locator("li .word")).to_have_text(word)
                for each in fresh:
                    expect(each).to_be_hidden()
                expect(page.locator("#ready")).to_have_class("verdict away")
                expect(page.locator("#strip")).to_have_css("filter", "grayscale(1)")
                expect(page.locator("#tool-notes p")).to_have_count(0)
                for of in ("left", "half", "without", "taken"):
                    expect(page.locator(f"[data-of={of}]")).to_have_text(["–"] * 3)
                expect(page.locator("#helps p")).to_have_count(0)
                expect(page.locator("#ready")).not_to_contain_text(re.compile(r"\d\s*µm"), use_inner_text=True)
                expect(machines.locator("li")).not_to_contain_text("\u202fµm")
                expect(machines.locator("li .notice")).to_have_count(0)
                assert page.evaluate("document.body.classList.contains('past')")
                for each in (coming, moved, foreseen):
                    expect(each).to_have_count(0)
                expect(page.locator("#warm-empty")).to_have_text(texts("en")["scenario.no_forecast"])
                for shown in ("#why-axes", "#moment-why", "#day-shown"):
                    expect(page.locator(shown)).to_have_css("filter", "grayscale(1)")

            os.kill(rig.web.pid, signal.SIGSTOP)
            expect_nothing_fresh("No connection")
            os.kill(rig.web.pid, signal.SIGCONT)
            expect(page.locator("#word")).to_have_text("Not ready")
            expect(page.locator("#axes [data-axis=Z] [data-of=half]")).not_to_have_text("–")
            expect(machines.locator("li .notice")).to_have_count(2)
            expect(coming).to_be_attached()
            gateway.kill()
            expect_nothing_fresh("Gone")


def test_a_user_with_a_key_gives_commands_after_a_second_confirmation(tmp_path: Path) -> None:
    key, file = tmp_path / "anna.key", tmp_path / "web.toml"
    key.write_text("anna" * 10, encoding="utf-8")
    hashed = make_hash("secret")
    file.write_text(f'[users]\nanna = "{hashed}"\neve = "{hashed}"\n[operators]\nanna = "anna.key"\n', encoding="utf-8")
    (port,) = ports(1)
    with page_rig() as rig:
        gateway = rig.commanded_gateway(port, "mill", "anna", key)
        rig.serve([port], file)
        with rig.page("/machine/mill", user=("eve", "secret")) as page:
            expect(page.locator("#health")).to_contain_text("ready")
            expect(page.locator("#commands")).to_have_count(0)
        with rig.page("/machine/mill", user=("anna", "secret"), trusted=True) as page:
            expect(page.locator("#health")).to_contain_text("ready")  # the script runs
            page.locator("#command-pause").press("Enter")
            expect(page.locator("#confirm-text")).to_contain_text("The offsets of mill go slowly")
            assert violations(page) == []
            page.keyboard.press("Escape")
            expect(page.locator("#confirm")).to_be_hidden()
            page.locator("#command-pause").press("Enter")
            page.locator("#confirm-yes").press("Enter")
            assert gateway.hear() == "anna pause"
            expect(page.locator("#command-answer")).to_have_text("Accepted: it is done")
            expect(page.locator("#notices")).to_contain_text("The compensation is paused by anna since")
            expect(page.locator("#command-pause")).to_have_text("Resume the compensation")
            page.click("#command-measure")
            page.click("#confirm-no")
            page.click("#command-pause")
            page.click("#confirm-yes")
            assert gateway.hear() == "anna resume", "what was not confirmed was not sent"
            expect(page.locator("#command-pause")).to_have_text("Pause the compensation")
            page.click("#command-measure")
            page.click("#confirm-yes")
            assert gateway.hear().startswith("anna measure anna may not give this command")
            expect(page.locator("#command-answer")).to_contain_text("Refused: anna may not give this command")
            expect(page.locator("#events")).to_contain_text("anna: resume")
        with rig.page("/machine/mill?lang=de", user=("anna", "secret")) as page:
            page.click("#command-measure")
            expect(page.locator("#confirm")).to_contain_text("Ist die Kugel sauber")
            page.keyboard.press("Escape")
            assert rig.web is not None
            os.kill(rig.web.pid, signal.SIGSTOP)
            expect(page.locator("#commands")).to_be_hidden()
            os.kill(rig.web.pid, signal.SIGCONT)
            expect(page.locator("#commands")).to_be_visible()
            gateway.kill()
            expect(page.locator("#commands")).to_be_hidden()
