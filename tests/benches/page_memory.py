"""Plays days of telemetry as fast as the page takes them, with one browser open, and reports the memory that this
takes.

`python -m tests.benches.page_memory DAYS [EVERY_S]`: 29 channels each second, or each EVERY_S, with a decision, a step
of the compensation and a forecast each 5 min, reasons and an event each hour. Prints a line for every tenth of the
days: memory of the page's process, the used heap of the tab after a collection, and its nodes. Ends when the tab shows
the last event.
"""

import sys
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from typing import Any

from playwright.sync_api import CDPSession

from tests.benches.page_rig import PageRig, page_rig
from tests.benches.played_page import played_page, resident_mb
from tests.benches.played_telemetry import recorded

_CHANNELS, _STEP_S, _HOUR_S, _LINES = 29, 300, 3600, 10


def _messages(
    second: int, k: int, last: dict[str, dict[str, Any]], every_s: int
) -> Iterator[tuple[str, dict[str, Any]]]:
    """What is published in this second."""
    if second % every_s == 0:
        readings = [key for key in last if key.startswith("reading/")][:_CHANNELS]
        for n, key in enumerate(readings):
            yield key, {"value": round(20.0 + n + second % 600 / 100.0, 1)}
    if second % _STEP_S == 0:
        for key in ("decision", "compensation", "forecast"):
            yield key, {"k": k}
    if second % _HOUR_S == 0:
        yield "reasons", {"k": k}
        yield "event", {"text": f"hour {second // _HOUR_S}"}


def _tab(session: CDPSession) -> tuple[float, int]:
    """Used heap in MB after a collection, and nodes of the document."""
    session.send("HeapProfiler.collectGarbage")
    found = {m["name"]: m["value"] for m in session.send("Performance.getMetrics")["metrics"]}
    return found["JSHeapUsedSize"] / 1e6, int(found["Nodes"])


def _play(rig: PageRig, days: float, every_s: int) -> None:
    last = dict(recorded())
    with played_page(rig) as (gateway, pid), rig.page("/machine/mill") as page:
        tab = page.context.new_cdp_session(page)
        tab.send("Performance.enable")
        for key, message in last.items():
            gateway.publish(key, message)
        page.wait_for_selector("#channels li")
        began, total = datetime(2026, 3, 2, tzinfo=UTC), round(days * 86400)
        first_k, sent = int(began.timestamp()) // _STEP_S, 0
        print("| played | messages | page's process | tab's heap | nodes |\n|---|---|---|---|---|", flush=True)
        for second in range(total + 1):
            now = (began + timedelta(seconds=second)).isoformat()
            for key, changes in _messages(second, first_k + second // _STEP_S, last, every_s):
                gateway.publish(key, last[key] | {"time": now} | changes)
                sent += 1
            if second % (total // _LINES) == 0:
                heap, nodes = _tab(tab)
                memory = resident_mb(pid)
                day = f"{second / 86400:.1f} days"
                print(f"| {day} | {sent} | {memory:.0f} MB | {heap:.1f} MB | {nodes} |", flush=True)
        page.select_option("#event-kind", "")
        page.locator("#events td", has_text=f"hour {total // _HOUR_S}").first.wait_for()


if __name__ == "__main__":
    with page_rig() as started:
        _play(started, float(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 1)
