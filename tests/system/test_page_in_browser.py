"""The page for operators as a browser shows it: live telemetry of the demo's machine, and gateways that go and come.

The pictures go to out/page; `make pictures` copies them into the documentation.
"""

import json
import re
from io import BytesIO
from pathlib import Path

import pytest
from PIL import Image
from playwright.sync_api import Page, expect

from tests.benches.npm_peer import PEERS, node_with
from tests.benches.page_rig import LIMIT_MS, ChildProgram, PageRig, page_rig, ports

pytestmark = [pytest.mark.peer, pytest.mark.slow]

PICTURES = Path(__file__).parents[2] / "out" / "page"
SETTINGS = "[machine.mill]\ntolerance_um = 8.0\nsphere_radius_mm = 200.0\n"
SIZES = ((1400, 900), (1024, 600), (390, 844))

expect.set_options(timeout=LIMIT_MS)


@pytest.fixture
def settings(tmp_path: Path) -> Path:
    file = tmp_path / "web.toml"
    file.write_text(SETTINGS, encoding="utf-8")
    return file


def started(rig: PageRig, settings: Path) -> ChildProgram:
    """One gateway that has published the day of the demo's machine, after the page's program listened."""
    (port,) = ports(1)
    gateway = rig.gateway(port, "mill")
    rig.serve([port], settings)
    with rig.page("/machine/mill") as page:
        expect(page.locator("#word")).to_have_text("No data yet")  # alive, and fresh
        gateway.say("")
        assert gateway.hear() == "published"
        expect(page.locator("#event-kind option")).not_to_have_count(2)
    return gateway


def picture(page: Page, name: str, *, whole: bool = False) -> None:
    """A small file of what is seen, or of the whole page."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    with Image.open(BytesIO(page.screenshot(full_page=whole))) as shown:
        shown.quantize(128).save(PICTURES / f"{name}.png", optimize=True)


def widest(page: Page) -> int:
    return int(page.evaluate("document.documentElement.scrollWidth"))


def test_each_part_shows_live_data(settings: Path) -> None:
    with page_rig() as rig:
        started(rig, settings)
        for width, height in SIZES:
            for dark in (False, True):
                with rig.page("/machine/mill", width, height, dark=dark) as page:
                    expect(page.locator("#axes .u-over")).to_have_count(3)
                    expect(page.locator("#word")).to_have_text(re.compile("^(Ready|Not sure|Not ready)$"))
                    assert widest(page) <= width
                    picture(page, f"page-{width}-{'dark' if dark else 'light'}", whole=(width, dark) == (1400, False))
        with rig.page("/machine/mill") as page:
            expect(page.locator("#because")).to_contain_text("left at the tool (95 %)")
            for axis in "XYZ":
                expect(page.locator(f"[data-axis={axis}] [data-of=half]")).to_have_text(
                    re.compile(r"^\d+\.\d\u202fµm$")
                )
            expect(page.locator("#waits")).to_contain_text("compensation")
            expect(page.locator("#waits")).to_contain_text("Last measurement")
            expect(page.locator("#channels li")).to_have_count(30)
            expect(page.locator("#drives tbody tr")).to_have_count(9)
            expect(page.locator("#health")).to_contain_text("30 of 30 good")
            page.select_option("#event-kind", "")
            expect(page.locator("#events tbody tr")).not_to_have_count(0)
            page.fill("#event-text", "nothing has this text")
            expect(page.locator("#events-empty")).to_have_text("No event matches the filter.")


def test_what_others_name_stays_a_name_and_a_failing_sensor_is_seen(settings: Path) -> None:
    with page_rig() as rig:
        gateway = started(rig, settings)
        with rig.page("/machine/mill") as page:
            forged = "<script>document.title='forged'</script>"
            name = "<img src=x onerror=alert(1)>"
            gateway.say("event " + json.dumps({"text": forged, "kind": "problem"}))
            gateway.say("reading/ambient_left " + json.dumps({"quality": "sensor_fault", "value": None}))
            gateway.say("reading/forged " + json.dumps({"channel": name, "value": 1.0}))
            expect(page.locator("#events tbody tr").first).to_contain_text(forged)
            expect(page.locator("#channels li")).to_have_count(31)
            expect(page.locator("#channels")).to_contain_text(name)
            expect(page.locator("#channels li").first).to_contain_text("ambient_left – sensor fault")
            expect(page.locator("#doubts")).to_contain_text("No good value: ambient_left")
            assert page.locator("#channels img").count() == 0
            assert "forged" not in page.title()


def test_the_tolerance_and_the_point_are_this_browsers_and_the_keyboard_is_enough(settings: Path) -> None:
    with page_rig() as rig:
        started(rig, settings)
        with rig.page("/machine/mill") as page:
            expect(page.locator("input[name=tolerance]")).to_have_value("8.0")
            page.keyboard.press("Tab")
            assert page.evaluate("document.activeElement.className") == "skip"
            page.focus("input[name=tolerance]")
            page.keyboard.press("Control+A")
            page.keyboard.type("1000")
            page.keyboard.press("Enter")
            expect(page.locator("#word")).to_have_text("Ready")
            page.reload()
            expect(page.locator("#word")).to_have_text("Ready")
            before = page.locator("[data-axis=Y] [data-of=half]").inner_text()
            page.fill("input[name=x]", "0")
            page.click("button[type=submit]")
            expect(page.locator("[data-axis=Y] [data-of=half]")).not_to_have_text("–")
            page.click("button[type=reset]")
            expect(page.locator("input[name=tolerance]")).to_have_value("8.0")
            expect(page.locator("[data-axis=Y] [data-of=half]")).to_have_text(before)
        with rig.page("/machine/mill", locale="de-DE") as page:
            expect(page.locator("h2").nth(2)).to_have_text("Worauf sie wartet")
            expect(page.locator("[data-axis=Y] [data-of=half]")).to_have_text(before.replace(".", ","))
            page.emulate_media(media="print")
            expect(page.locator("form")).to_be_hidden()


def test_a_gateway_that_is_killed_looks_gone_and_one_that_comes_back_begins_anew(settings: Path) -> None:
    with page_rig() as rig:
        port, other = ports(2)
        mill, lathe = rig.gateway(port, "mill"), rig.gateway(other, "lathe")
        rig.serve([port, other], settings)
        with rig.page("/machine/mill") as page, rig.page("/?all=1") as machines:
            expect(page.locator("#word")).to_have_text("No data yet")
            mill.say("")
            expect(page.locator("#axes .u-over")).to_have_count(3)
            lathe.say("")
            expect(machines.locator("li")).to_have_count(2)
            lathe.say("status " + json.dumps({"unarmed": ["nothing will be learnt: probing is not armed"]}))
            expect(machines.locator("li .notice")).to_have_text(
                "Not armed: nothing will be learnt: probing is not armed"
            )
            mill.kill()
            expect(page.locator("#word")).to_have_text("Gone")
            expect(page.locator("#because")).to_contain_text("Last heard")
            expect(page.locator("[data-axis=Z] [data-of=left]")).to_have_text("–")
            assert page.evaluate("document.body.classList.contains('past')")
            picture(page, "page-gone")
            expect(machines.locator("li .name").first).to_have_text("mill")
            rig.gateway(port, "mill", "nothing")
            expect(page.locator("#word")).to_have_text("No data yet")
            assert rig.web is not None
            rig.web.kill()
            expect(page.locator("#lost")).to_contain_text("This page has lost its server")
            expect(page.locator("#word")).to_have_text("No connection")


_LOOKED_AT = (
    ("/machine/mill", False, True),
    ("/machine/mill", True, True),
    ("/?all=1", False, True),
    ("/machine/mill", False, False),
    ("/machine/mill", True, False),
)
"""Path, dark, and whether its gateway is alive."""


def test_axe_finds_no_violation(settings: Path) -> None:
    node_with("axe", "axe-core")
    axe = (PEERS / "axe" / "node_modules" / "axe-core" / "axe.min.js").read_text("utf-8")
    with page_rig() as rig:
        gateway = started(rig, settings)
        for path, dark, alive in _LOOKED_AT:
            if not alive:
                gateway.kill()
            with rig.page(path, dark=dark, trusted=True) as page:
                expect(page.locator("#axes .u-over").or_(page.locator("#machines li")).first).to_be_attached()
                if not alive:
                    expect(page.locator("#word")).to_have_text("Gone")
                page.add_script_tag(content=axe)
                found = page.evaluate(
                    "axe.run().then((r) => r.violations.map((v) => [v.id, v.nodes.map((n) => n.html)]))"
                )
                assert found == []
