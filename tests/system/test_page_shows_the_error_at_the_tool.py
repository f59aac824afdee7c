"""The numbers and the charts of the error at the tool, as a browser shows them."""

import csv
import json
import re
from datetime import UTC, datetime, timedelta
from io import BytesIO
from pathlib import Path

import pytest
from PIL import Image, ImageColor
from playwright.sync_api import Locator, Page, expect

from gateway.model.text import texts
from talc.names import THERMAL_ERRORS
from tests.benches.page_rig import LIMIT_MS, PageRig, page_rig, played_mill
from tests.benches.page_shifts import TWO_FRAMES

pytestmark = [pytest.mark.peer, pytest.mark.slow]

expect.set_options(timeout=LIMIT_MS)

_CURVES = "(canvas) => canvas.toDataURL()"
"""Without the cursor over them."""
_STILL = dict.fromkeys(THERMAL_ERRORS, 0.0)


def drawn(page: Page, ink: str) -> int:
    """How many pixels of the chart have exactly this colour of the page."""
    named = page.evaluate("(ink) => getComputedStyle(document.documentElement).getPropertyValue('--' + ink)", ink)
    with Image.open(BytesIO(page.locator("#chart canvas").screenshot())) as seen:
        found = seen.convert("RGB").getcolors(seen.width * seen.height)
    assert found is not None
    return sum(n for n, colour in found if colour == ImageColor.getrgb(named.strip()))


def signed(um: float) -> str:
    return "0.0\u202fµm" if abs(um) < 0.05 else f"{um:+.1f}\u202fµm".replace("-", "\u2212")


def um_of(text: str) -> float:
    """The last number of a text, without its interval."""
    return float(re.findall(r"[+\u2212]?[\d.]+", text.partition(" ±")[0])[-1].replace("\u2212", "-"))


def number(page: Page, axis: str, of: str) -> Locator:
    return page.locator(f"[data-axis={axis}] [data-of={of}]")


def test_each_number_stands_where_its_name_is(settings: Path) -> None:
    """The table has grown by 30 µm, of which the control has taken back 10 and will have taken back 28."""
    with page_rig() as rig:
        gateway = played_mill(rig, settings)
        with rig.page("/machine/mill") as page:
            offsets = {"target_um": [0.0, 0.0, 28.0], "offsets_um": [0.0, 0.0, 10.0], "source": "prediction"}
            gateway.say("compensation " + json.dumps(offsets | {"bounded": [False] * 3}))
            grown = {"corrected": _STILL | {"EZ0T": 30.0}, "sigma": _STILL | {"EZ0T": 2.0}}
            gateway.say("decision " + json.dumps(grown | {"phase": "compensation"}))
            expect(number(page, "Z", "without")).to_have_text("+30.0\u202fµm")
            expect(number(page, "Z", "taken")).to_have_text("+12.0\u202fµm")
            expect(page.locator("#on-control")).to_contain_text("Z +10.0")
            expect(number(page, "Z", "left")).to_have_text("+18.0")
            expect(number(page, "Z", "half")).to_have_text("4.0\u202fµm")  # 1.96 of 2 µm, rounded up
            expect(number(page, "X", "without")).to_have_text("0.0\u202fµm")
            expect(number(page, "Z", "far")).to_have_text("22.0")
            expect(page.locator(".now-table thead th")).to_have_count(4)
            expect(number(page, "Z", "interval")).to_have_text("+18.0 ± 4.0\u202fµm")
            expect(page.locator("#because")).to_contain_text("22.0\u202fµm")
            expect(page.locator("#because")).to_contain_text(re.compile(r"\bZ\b"))


def test_the_bars_show_which_part_of_an_interval_is_outside_the_tolerance(settings: Path) -> None:
    """Of 18 ± 3.9 µm nothing, a part and all is within ± 100, ± 20 and ± 8 µm."""
    with page_rig() as rig:
        gateway = played_mill(rig, settings)
        grown = {"corrected": _STILL | {"EZ0T": 18.0}, "sigma": _STILL | {"EZ0T": 2.0}, "phase": "compensation"}
        with rig.page("/machine/mill", 1024, 600) as page:
            gateway.say("compensation " + json.dumps({"mode": "advise", "source": "prediction"}))
            gateway.say("decision " + json.dumps(grown))
            bars = page.locator("[data-axis=Z] .bar")
            for tolerance, kinds in (("100", ["bar"]), ("20", ["bar", "bar warn"]), ("8", ["bar bad"])):
                page.fill("#tolerance", tolerance)
                page.keyboard.press("Enter")
                expect(bars).to_have_count(len(kinds))
                expect(bars.first).to_have_class(kinds[0])
                assert [bar.get_attribute("class") for bar in bars.all()] == kinds
            for seen in ("#word", "#because p", "[data-axis=X] .number", "[data-axis=Z] .bar", "[data-axis=Z] .number"):
                expect(page.locator(seen)).to_be_in_viewport(ratio=1.0)
            page.click("#wider")
            expect(page.locator("#tolerance")).to_have_value("8.5")
            page.click("#tighter")
            expect(page.locator("#tolerance")).to_have_value("8")


def test_the_chart_draws_what_is_left_and_the_measurements(looked_at: PageRig) -> None:
    with looked_at.page("/machine/mill#time") as page:
        expect(page.locator("#chart .u-over")).to_have_count(1)
        assert drawn(page, "after") > 50, "what is left"
        assert drawn(page, "measured") > 50, "dots"


def test_a_drag_and_the_wheel_zoom_and_a_double_click_shows_all(looked_at: PageRig) -> None:
    with looked_at.page("/machine/mill#time") as page:
        over, canvas = page.locator("#chart .u-over"), page.locator("#chart canvas")
        expect(over).to_have_count(1)
        box = over.bounding_box()
        assert box is not None
        page.mouse.move(box["x"] + box["width"] / 3, box["y"] + 40)
        expect(page.locator("#reading")).to_contain_text("µm")
        whole = canvas.evaluate(_CURVES)
        page.mouse.down()
        page.mouse.move(box["x"] + box["width"] / 2, box["y"] + 40, steps=5)
        page.mouse.up()
        page.evaluate(TWO_FRAMES)
        zoomed = canvas.evaluate(_CURVES)
        assert zoomed != whole
        page.mouse.wheel(0.0, -300.0)
        page.evaluate(TWO_FRAMES)
        closer = canvas.evaluate(_CURVES)
        assert closer != zoomed
        over.dblclick()
        page.evaluate(TWO_FRAMES)
        assert canvas.evaluate(_CURVES) not in {zoomed, closer}


def test_what_moved_the_tool_at_a_clicked_moment_adds_up_and_what_is_seen_is_exported(looked_at: PageRig) -> None:
    """The store's reasons are of each full hour before the played day; what has changed since is a part by itself."""
    with looked_at.page("/machine/mill#time", zone="UTC") as page:
        over = page.locator("#chart .u-over")
        expect(over).to_have_count(1)
        page.select_option("#span", "168")
        box = over.bounding_box()
        assert box is not None

        day = (datetime.now(UTC) - timedelta(0.87 * 7)).day

        def days_ago() -> bool:
            """Whether the week is drawn: until then a click chooses one of the hours that only the page has heard."""
            for share in (0.5, 0.13):
                over.hover(position={"x": share * box["width"], "y": 60})
            return f" {day} " in page.locator("#reading-title").inner_text()

        while not days_ago():
            page.evaluate(TWO_FRAMES)
        changed, stack = [], page.locator("#moment-why .stack")
        for share in (0.13, 0.31, 0.5, 0.52, 0.77, 0.9):
            with (
                page.expect_response(re.compile("/corrections/mill.before=")),
                page.expect_response(re.compile("errors=1")),
            ):
                over.click(position={"x": share * box["width"], "y": 60})
            expect(stack.locator(".part-of")).not_to_have_count(0)
            page.mouse.move(0, 0)  # the reading is of the moment
            at, drawn_at = (
                page.locator(title).inner_text().split(" · ")[1] for title in ("#moment-title", "#reading-title")
            )
            assert at == drawn_at == page.locator("#why-moment").text_content()
            parts = {part.rsplit("\u00a0", 1)[0]: um_of(part) for part in stack.locator(".part-of").all_inner_texts()}
            total = um_of(stack.locator(".total").inner_text())
            assert sum(parts.values()) == pytest.approx(total, abs=0.01)
            assert total == pytest.approx(
                um_of(page.locator(f"#reading dt:text-is('{texts('en')['chart.without']}') + dd").inner_text()),
                abs=0.11,
            )
            assert 1.0 in parts.values(), "c_table"
            changed += [um for name, um in parts.items() if name.startswith(texts("en")["moves.since"].split("{")[0])]
        assert max(map(abs, changed)) > 2.0, "of up to 10 µm an hour"
        with page.expect_response(lambda answer: "temperatures=1" in answer.url):
            page.check("#series input[name=spindle_speed]")  # it moves none of the errors
        expect(page.locator("#reading")).to_contain_text(re.compile(r"spindle_speed1,500\.0\s1/min"))
        with page.expect_download() as saved:
            page.click("#csv")
        lines = list(csv.DictReader(saved.value.path().read_text("utf-8").splitlines()))
        assert {"time_utc", "without_um", "left_um", "measured_um"} <= lines[0].keys()
        assert len(lines) > 50
        assert sum(line["spindle_speed 1/min"] == "1500" for line in lines) > 50
        with page.expect_download() as drawn_file:
            page.click("#png")
        with Image.open(drawn_file.value.path()) as picture:
            assert picture.width >= box["width"]


_WARMTH = """(part) => {
  const canvas = document.createElement("canvas").getContext("2d");
  canvas.fillStyle = getComputedStyle(document.querySelector(`#sketch [data-part=${part}] .lit`)).fill;
  canvas.fillRect(0, 0, 1, 1);
  const [red, , blue] = canvas.getImageData(0, 0, 1, 1).data;
  return red - blue;
}"""
_CENTRE = """(part) => {
  const { x, y, width, height } = document.querySelector(`#sketch [data-part=${part}]`).getBBox();
  return [x + width / 2, y + height / 2];
}"""


def test_the_drawing_is_coloured_by_temperature_and_bent_by_the_errors(settings: Path) -> None:
    with page_rig() as rig:
        gateway = played_mill(rig, settings)
        with rig.page("/machine/mill") as page:
            warmth = list[int]()
            for degrees in (19.0, 25.0, 31.0):
                for channel in ("c_table", "c_drive"):
                    gateway.say(f"reading/{channel} " + json.dumps({"value": degrees}))
                expect(page.locator("#sketch [data-body=table] .number")).to_have_text(f"{degrees}\u202f°C")
                warmth.append(page.evaluate(_WARMTH, "table"))
            assert warmth[0] + 30 < warmth[1] < warmth[2] - 30, "blue, then brown"

            def centres(errors: dict[str, float], axis: str) -> list[list[float]]:
                gateway.say("decision " + json.dumps({"corrected": _STILL | errors, "phase": "compensation"}))
                expect(number(page, axis, "without")).to_have_text(signed(sum(errors.values())))
                return [page.evaluate(_CENTRE, part) for part in ("table", "cradle", "bed")]

            still = centres({}, "Z")
            for error, axis, moved in (("EX0C", "X", "table"), ("EZ0T", "Z", "table"), ("EZ0A", "Z", "table cradle")):
                for um in (20.0, -20.0):
                    for part, cold, now in zip(
                        ("table", "cradle", "bed"), still, centres({error: um}, axis), strict=True
                    ):
                        right, down = (after - before for after, before in zip(now, cold, strict=True))
                        towards = right if axis == "X" else -down
                        assert towards * um > 40.0 if part in moved else (right, down) == (0.0, 0.0), (error, um, part)
