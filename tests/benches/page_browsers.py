"""Opens the page in several browsers at once, and reports how fast they show what is published and what this costs.

`python -m tests.benches.page_browsers BROWSERS SECONDS`: one gateway publishes 29 channels each second. Prints a table:
first paint of each browser with an empty cache, when it shows the state of the machine, the time from publishing a
reading until the frame that shows it, and CPU and memory of the page's process. The computer should do nothing else;
its load is printed, too.
"""

import os
import sys
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path
from statistics import median
from time import monotonic, sleep, time
from typing import Any

from playwright.sync_api import Page

from tests.benches.page_rig import PageRig, page_rig
from tests.benches.played_page import played_page, resident_mb
from tests.benches.played_telemetry import PlayedGateway, recorded

_CHANNELS = 29
_WATCH = """(channel) => {
  window.shown = [];
  const look = () => requestAnimationFrame(() => setTimeout(() => {
    const item = [...document.querySelectorAll("#channels li")].find((li) => li.firstChild.textContent === channel);
    const text = item.querySelector(".number").textContent;
    if (!window.shown.length || window.shown.at(-1)[0] !== text) {
      window.shown.push([text, performance.timeOrigin + performance.now()]);
    }
  }));
  new MutationObserver(look).observe(document.getElementById("channels"), { childList: true, subtree: true });
}"""
"""Notes each value that a channel shows, and when the frame with it was drawn."""


def _first_paint_ms(page: Page) -> float:
    page.wait_for_selector("#channels li")
    return float(page.evaluate("performance.getEntriesByName('first-contentful-paint')[0].startTime"))


def _state_ms(page: Page) -> float:
    """When the largest text was drawn: before the machine's state comes, the page says only that it connects."""
    return float(
        page.evaluate(
            """() => new Promise((found) => new PerformanceObserver((list) => found(list.getEntries().at(-1).startTime))
              .observe({ type: "largest-contentful-paint", buffered: true }))"""
        )
    )


def _cpu_s(pid: int) -> float:
    """Processor time in user and kernel mode, proc_pid_stat(5)."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _publish(gateway: PlayedGateway, readings: dict[str, dict[str, Any]], seconds: int) -> list[tuple[str, float]]:
    """Publish each second; the text of the first channel's value, and when it was published, UTC ms."""
    sent, began = list[tuple[str, float]](), monotonic()
    for second in range(seconds):
        sleep(max(0.0, began + second - monotonic()))
        value = 20.0 + second % 600 / 10.0
        sent.append((f"{value:.1f}\u202f°C", time() * 1e3))
        for key, message in readings.items():
            gateway.publish(key, message | {"time": datetime.now(UTC).isoformat(), "value": value})
    return sent


def _measure(rig: PageRig, browsers: int, seconds: int) -> None:
    last = dict(recorded())
    readings = {key: last[key] for key in [key for key in last if key.startswith("reading/")][:_CHANNELS]}
    with played_page(rig) as (gateway, pid), ExitStack() as stack:
        for key, message in last.items():
            gateway.publish(key, message)
        pages = [stack.enter_context(rig.page("/machine/mill")) for _ in range(browsers)]
        paints = [_first_paint_ms(page) for page in pages]
        states = [_state_ms(page) for page in pages]
        for page in pages:
            page.evaluate(_WATCH, next(iter(readings.values()))["channel"])
        cpu_s, began = _cpu_s(pid), monotonic()
        sent = _publish(gateway, readings, seconds)
        share = (_cpu_s(pid) - cpu_s) / (monotonic() - began)
        for page in pages:
            page.wait_for_function("(last) => window.shown.some(([text]) => text === last)", arg=sent[-1][0])
        shown = [dict(page.evaluate("window.shown")) for page in pages]
        delays = [each[text] - published for each in shown for text, published in sent if text in each]
        print("| browsers | load | first paint, median and longest | state shown | reading to pixel | CPU | memory |")
        print("|---|---|---|---|---|---|---|")
        print(
            f"| {browsers} | {os.getloadavg()[0]:.1f} | {median(paints):.0f} ms, {max(paints):.0f} ms"
            f" | {median(states):.0f} ms, {max(states):.0f} ms | {median(delays):.0f} ms, {max(delays):.0f} ms"
            f" ({len(delays)} of {browsers * len(sent)}) | {100.0 * share:.1f} % | {resident_mb(pid):.0f} MB |"
        )


if __name__ == "__main__":
    with page_rig() as started:
        _measure(started, int(sys.argv[1]), int(sys.argv[2]))
