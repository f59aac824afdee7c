"""Kills gateways and starts them again while a browser shows them, and reports how soon the page says so.

`python -m tests.benches.page_gone TIMES`: prints a table of the time from SIGKILL until the frame that says *Gone*, and
from when the next gateway can be reached until the frame that no longer says it.
"""

import os
import sys
import tempfile
from pathlib import Path
from statistics import median
from time import time

from playwright.sync_api import Page, expect

from tests.benches.page_rig import MILL_SETTINGS, PageRig, page_rig, ports

_WATCH = """() => {
  window.said = [];
  const look = () => requestAnimationFrame(() => setTimeout(() => {
    window.said.push([document.getElementById("word").textContent, performance.timeOrigin + performance.now()]);
  }));
  new MutationObserver(look).observe(document.getElementById("word"), { childList: true, subtree: true });
}"""
"""Notes each word of the verdict, and when the frame with it was drawn."""
_SHOWN = "(word) => (window.said.find(([said]) => (said === 'Gone') === (word === 'Gone')) || [null, 0])[1]"


def _shown_ms(page: Page, word: str) -> float:
    """UTC milliseconds at which the page says this, or no longer says that the gateway is gone."""
    page.wait_for_function(_SHOWN, arg=word)
    return float(page.evaluate(_SHOWN, word))


def _measure(rig: PageRig, times: int, settings: Path) -> None:
    (port,) = ports(1)
    gateway = rig.gateway(port, "mill")
    rig.serve([port], settings)
    gone, back = list[float](), list[float]()
    with rig.page("/machine/mill") as page:
        expect(page.locator("#word")).to_have_text("No data yet")
        for _ in range(times):
            page.evaluate(_WATCH)
            killed = time() * 1e3
            gateway.kill()
            gone.append(_shown_ms(page, "Gone") - killed)
            page.evaluate("window.said = []")
            gateway = rig.gateway(port, "mill")
            reached = time() * 1e3
            back.append(_shown_ms(page, "back") - reached)
    print("| kills | load | killed to Gone, median and longest | back to no longer Gone |\n|---|---|---|---|")
    print(
        f"| {times} | {os.getloadavg()[0]:.1f} | {median(gone):.0f} ms, {max(gone):.0f} ms"
        f" | {median(back):.0f} ms, {max(back):.0f} ms |"
    )


if __name__ == "__main__":
    with page_rig() as started, tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "web.toml"
        file.write_text(MILL_SETTINGS, encoding="utf-8")
        _measure(started, int(sys.argv[1]), file)
