"""The first page of a site: the focused link keeps the focus while machines change and move."""

import json
import re
from pathlib import Path

import pytest
from playwright.sync_api import expect

from tests.benches.page_rig import LIMIT_MS, page_rig, ports

pytestmark = [pytest.mark.peer, pytest.mark.slow]

MACHINES = ("lathe", "mill", "press")

expect.set_options(timeout=LIMIT_MS)


def test_a_link_keeps_the_keyboard_and_the_machines_are_counted(tmp_path: Path) -> None:
    settings = tmp_path / "web.toml"
    settings.write_text("".join(f"[machine.{name}]\ntolerance_um = 1000.0\n" for name in MACHINES), encoding="utf-8")
    where = ports(len(MACHINES))
    with page_rig() as rig:
        gateways = [rig.gateway(port, name) for port, name in zip(where, MACHINES, strict=True)]
        rig.serve(where, settings)
        with rig.page("/?all=1") as page:
            expect(page.locator("#summary")).to_have_text("No data yet: 3")
            for gateway in gateways:
                gateway.say("")
            expect(page.locator("#summary")).to_have_text("Ready: 3")
            expect(page.locator("#machines .name")).to_have_text([*MACHINES])
            page.locator("#machines a").nth(1).focus()
            gateways[2].say("decision " + json.dumps({"phase": "no_good"}))
            expect(page.locator("#machines .name")).to_have_text(["press", "lathe", "mill"])
            expect(page.locator("#summary")).to_have_text("Not ready: 1 · Ready: 2")
            gateways[1].say("decision " + json.dumps({"phase": "no_good"}))
            expect(page.locator("#machines .name")).to_have_text(["mill", "press", "lathe"])
            page.keyboard.press("Enter")
            expect(page).to_have_url(re.compile("/machine/mill"))
            expect(page.locator("#word")).to_have_text("Not ready")
