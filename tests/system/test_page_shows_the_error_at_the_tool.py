"""The numbers and the charts of the error at the tool, as a browser shows them."""

import json
from io import BytesIO
from pathlib import Path

import pytest
from PIL import Image, ImageColor
from playwright.sync_api import Locator, Page, expect

from talc.names import THERMAL_ERRORS
from tests.benches.page_rig import LIMIT_MS, page_rig, played_mill
from tests.benches.page_shifts import TWO_FRAMES

pytestmark = [pytest.mark.peer, pytest.mark.slow]

expect.set_options(timeout=LIMIT_MS)

_CURVES = "(canvas) => canvas.toDataURL()"
"""Without the cursor over them."""
_STILL = dict.fromkeys(THERMAL_ERRORS, 0.0)


def drawn(page: Page, ink: str) -> int:
    """How many pixels of the chart of Z have exactly this colour of the page."""
    named = page.evaluate("(ink) => getComputedStyle(document.documentElement).getPropertyValue('--' + ink)", ink)
    with Image.open(BytesIO(page.locator("[data-axis=Z] canvas").screenshot())) as seen:
        found = seen.convert("RGB").getcolors(seen.width * seen.height)
    assert found is not None
    return sum(n for n, colour in found if colour == ImageColor.getrgb(named.strip()))


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
            expect(number(page, "Z", "in_force")).to_have_text("+10.0\u202fµm")
            expect(number(page, "Z", "left")).to_have_text("+18.0")
            expect(number(page, "Z", "half")).to_have_text("3.9\u202fµm")  # 1.96 of 2 µm
            expect(number(page, "X", "without")).to_have_text("0.0\u202fµm")
            names = page.locator("[data-axis=Z] dt")
            expect(names).to_have_text(["without", "on the control"])
            expect(page.locator("#because")).to_contain_text("Z: 18.0\u202fµm ± 3.9\u202fµm left at the tool")
            expect(page.locator("#because")).to_contain_text("at most 21.9\u202fµm")


def test_the_chart_draws_what_is_left_and_the_measurements(settings: Path) -> None:
    with page_rig() as rig:
        played_mill(rig, settings)
        with rig.page("/machine/mill") as page:
            expect(page.locator("#axes .u-over")).to_have_count(3)
            assert drawn(page, "after") > 50, "dashes of what is left"
            assert drawn(page, "measured") > 50, "dots"


def test_the_pointer_over_one_chart_is_in_all_of_them_and_a_drag_zooms_all(settings: Path) -> None:
    with page_rig() as rig:
        played_mill(rig, settings)
        with rig.page("/machine/mill") as page:
            expect(page.locator("#axes .u-over")).to_have_count(3)
            readings, chart = page.locator("#axes .reading"), page.locator("[data-axis=X] .u-over")
            box = chart.bounding_box()
            assert box is not None
            page.mouse.move(box["x"] + box["width"] / 3, box["y"] + 40)
            expect(readings).to_contain_text(["µm"] * 3)
            assert len({told.partition(": ")[0] for told in readings.all_inner_texts()}) == 1, "one time"
            of_z = page.locator("[data-axis=Z] canvas")
            whole = of_z.evaluate(_CURVES)
            page.mouse.down()
            page.mouse.move(box["x"] + box["width"] / 2, box["y"] + 40, steps=5)
            page.mouse.up()
            page.evaluate(TWO_FRAMES)
            zoomed = of_z.evaluate(_CURVES)
            assert zoomed != whole
            chart.dblclick()
            page.evaluate(TWO_FRAMES)
            assert of_z.evaluate(_CURVES) != zoomed
