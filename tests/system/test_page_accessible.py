"""Everybody can use the page for operators: axe finds no violation, whatever the page shows."""

import json
import os
import signal
from pathlib import Path

import pytest
from playwright.sync_api import expect

from tests.benches.axe import violations
from tests.benches.page_rig import LIMIT_MS, SCREENS, page_rig, played_mill

pytestmark = [pytest.mark.peer, pytest.mark.slow]

expect.set_options(timeout=LIMIT_MS)

_DESKTOP, _PANEL, _PHONE = SCREENS
_LOOKED_AT = (
    ("/machine/mill", _PHONE, False, True),
    ("/machine/mill?lang=de#why", _DESKTOP, True, True),
    ("/machine/mill#time", _PANEL, False, True),
    ("/?all=1", _PHONE, False, True),
    ("/machine/mill#log", _DESKTOP, False, False),
    ("/machine/mill#sensors", _PANEL, True, False),
)
"""Path, screen, dark, and whether its gateway is alive."""


def test_axe_finds_no_violation(settings: Path) -> None:
    with page_rig() as rig:
        gateway = played_mill(rig, settings)
        for path, (width, height), dark, alive in _LOOKED_AT:
            if not alive:
                gateway.kill()
            with rig.page(path, width, height, dark=dark, trusted=True) as page:
                if alive:
                    expect(page.locator("#axes .bar").or_(page.locator("#machines li")).first).to_be_attached()
                else:
                    expect(page.locator("#word")).to_have_text("Gone")
                assert violations(page) == []


def test_axe_finds_no_violation_in_any_state(settings: Path) -> None:
    dark = True
    with page_rig() as rig:
        gateway = played_mill(rig, settings)
        assert rig.web is not None
        with rig.page("/machine/lathe", *_DESKTOP, dark=dark, trusted=True) as page:
            expect(page.locator("#word")).to_have_text("No contact")
            assert violations(page) == []
        with rig.page("/?all=1", *_PANEL, dark=dark, trusted=True) as machines:
            with rig.page("/machine/mill", *_PHONE, dark=dark, trusted=True) as page:
                gateway.say("status " + json.dumps({"unarmed": ["probing is not armed"]}))
                gateway.say("reading/ambient_left " + json.dumps({"quality": "sensor_fault", "value": None}))
                expect(page.locator("#doubts")).to_contain_text("ambient_left")
                page.fill("#tolerance", "3")
                page.keyboard.press("Enter")
                expect(page.locator("#word")).to_have_text("Not sure")
                assert violations(page) == []
                gateway.say("compensation " + json.dumps({"source": "stale"}))
                expect(page.locator("#word")).to_have_text("Not ready")
                assert violations(page) == []
                os.kill(rig.web.pid, signal.SIGSTOP)
                expect(page.locator("#word")).to_have_text("No connection")
                assert violations(page) == []
            expect(machines.locator("#machines .word")).to_have_text("No connection")
            assert violations(machines) == []
