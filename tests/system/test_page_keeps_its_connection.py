"""How the page for operators hears its server: through proxies, over networks that break, in many tabs of a browser."""

import asyncio
import json
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.benches.cut_wire import CutWire
from tests.benches.page_rig import LIMIT_MS, page_rig, played_mill

# A wire between a browser and the page's server that breaks as it is told, for tests that are not asynchronous.


class PageWire:
    """The server's address through the wire.

    Parameters
    ----------
    wire: that is open
    loop: in which it runs, in another thread
    address: of the page, through the wire
    """

    def __init__(self, wire: CutWire, loop: asyncio.AbstractEventLoop, address: str) -> None:
        self._wire, self._loop, self.address = wire, loop, address

    def cut(self) -> None:
        """End every connection, as a proxy does that allows no long answer; new ones pass."""
        asyncio.run_coroutine_threadsafe(self._wire.cut(), self._loop).result()

    def forget(self) -> None:
        """Let nothing pass through the connections that are open, without a word; new ones pass."""
        self._loop.call_soon_threadsafe(self._wire.forget)


@contextmanager
def page_wire(address: str) -> Iterator[PageWire]:
    """A wire to the page at `http://127.0.0.1:PORT/`."""
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever)
    thread.start()
    wire = CutWire(int(address.rstrip("/").rsplit(":", 1)[1]))
    try:
        joined = asyncio.run_coroutine_threadsafe(wire.open(), loop).result()
        yield PageWire(wire, loop, f"http://127.0.0.1:{joined.rsplit(':', 1)[1]}/")
    finally:
        asyncio.run_coroutine_threadsafe(wire.close(), loop).result()
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()


pytestmark = [pytest.mark.peer, pytest.mark.slow]

TABS = 9
"""More than the six connections that a browser has to one server."""
VERDICT = re.compile("^(Ready|Not sure|Not ready)$")

_HIDE = """() => {
  Object.defineProperty(document, "visibilityState", { configurable: true, get: () => "hidden" });
  document.dispatchEvent(new Event("visibilitychange"));
}"""
_SHOW = "() => { delete document.visibilityState; document.dispatchEvent(new Event('visibilitychange')); }"
_NOTE_WORDS = """() => {
  window.words = [];
  new MutationObserver(() => window.words.push(document.getElementById("word").textContent))
    .observe(document.getElementById("word"), { childList: true, characterData: true, subtree: true });
}"""

expect.set_options(timeout=LIMIT_MS)


def expect_fresh(page: Page, gateway_says: str) -> None:
    """Expect that the page has heard this event."""
    expect(page.locator("#word")).to_have_text(VERDICT)
    expect(page.locator("#events")).to_contain_text(gateway_says)
    expect(page.locator("#lost")).to_be_hidden()


def event(text: str) -> str:
    return "event " + json.dumps({"kind": "problem", "text": text})


def test_a_proxy_that_ends_long_answers_is_not_seen(settings: Path) -> None:
    with page_rig() as rig:
        gateway = played_mill(rig, settings)
        with page_wire(rig.address) as wire:
            rig.address = wire.address
            with rig.page("/machine/mill") as page:
                expect(page.locator("#word")).to_have_text(VERDICT)
                page.evaluate(_NOTE_WORDS)
                for n in range(3):
                    wire.cut()
                    gateway.say(event(f"after cut {n}"))
                    expect_fresh(page, f"after cut {n}")
                assert page.evaluate("window.words") == []
            assert rig.web is not None
            rig.web.kill()


@pytest.mark.waits(50)
def test_a_connection_that_broke_silently_is_made_again(settings: Path) -> None:
    """For instance, a panel was out of reach while its access point was replaced: nothing tells it that no more data
    will come."""
    with page_rig() as rig:
        gateway = played_mill(rig, settings)
        with page_wire(rig.address) as wire:
            rig.address = wire.address
            with rig.page("/machine/mill") as page:
                expect(page.locator("#word")).to_have_text(VERDICT)
                wire.forget()
                expect(page.locator("#word")).to_have_text("No connection")
                gateway.say(event("it is back"))
                expect_fresh(page, "it is back")


def test_more_tabs_than_a_browser_has_connections(settings: Path) -> None:
    with page_rig() as rig:
        gateway = played_mill(rig, settings)
        with rig.page("/machine/mill") as first:
            tabs = [first]
            for _ in range(TABS - 1):
                expect(tabs[-1].locator("#word")).to_have_text(VERDICT)
                tabs[-1].evaluate(_HIDE)
                tabs.append(first.context.new_page())
                tabs[-1].goto(first.url)
            expect(tabs[-1].locator("#word")).to_have_text(VERDICT)
            gateway.say(event("heard by those that are seen"))
            expect_fresh(tabs[-1], "heard by those that are seen")
            # Two of the hidden tabs still listen; the others do not show what they do not know.
            told = [tab.title() for tab in tabs[:-1]]
            assert sum(title != "mill" for title in told) == 2
            resting = tabs[told.index("mill")]
            assert resting.locator("#word").inner_text() == "Connecting"
            expect(resting.locator("[data-of=left]")).to_have_text(["–"] * 3)
            tabs[-1].evaluate(_HIDE)
            resting.evaluate(_SHOW)
            expect_fresh(resting, "heard by those that are seen")
            expect(resting).to_have_title(re.compile("^(Ready|Not sure|Not ready) · mill$"))


@pytest.mark.parametrize(("hours", "said"), [(24.0, "24.0\u202fh fast")])
def test_a_screen_whose_clock_is_wrong_says_so_and_takes_no_other_day_for_today(
    settings: Path, hours: float, said: str
) -> None:
    with page_rig() as rig:
        played_mill(rig, settings)
        with rig.page("/?all=1") as page:
            expect(page.locator("#machines li")).to_have_count(1)
            expect(page.locator("#clock-off")).to_be_hidden()
            told = page.locator("#machines .note").inner_text()
            page.add_init_script(
                f"const real = Date.now, off = {hours * 3.6e6}; Date.now = () => real() + off;"
                "Date = class extends Date { constructor(...a) { super(...(a.length ? a : [real() + off])); } }"
            )
            page.reload()
            expect(page.locator("#clock-off")).to_contain_text(said)
            assert page.locator("#machines .note").inner_text()[:18] == told[:18], "no day before the time"
