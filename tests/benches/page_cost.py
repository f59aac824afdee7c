"""`python -m tests.benches.page_cost`: what the page for operators costs.

Prints the bytes of a first visit in Debian's chromium, with what comes from the store, and when it is painted; and what
share of a core the page's program takes for the telemetry of a machine with 30 channels at 1 Hz: without browsers, and
with ten that hear its stream.
"""

import json
import os
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import urlsplit

from tests.benches.page_rig import MILL_SETTINGS, ChildProgram, PageRig, page_rig, played_mill
from tests.benches.played_telemetry import recorded

BROWSERS, SECONDS = 10, 30
_VISIT = """() => {
  const seen = [...performance.getEntriesByType("navigation"), ...performance.getEntriesByType("resource")];
  return [seen.reduce((sum, each) => sum + each.transferSize, 0),
    performance.getEntriesByName("first-contentful-paint")[0].startTime]; }"""


def _core_s(pid: int) -> float:
    """Seconds of a core that a process has taken."""
    fields = Path(f"/proc/{pid}/stat").read_text("utf-8").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def _hearing(address: str, browsers: int) -> Iterator[list[int]]:
    """Streams that are read as browsers do; yields how many bytes each has brought."""
    heard, place = [0] * browsers, urlsplit(address)

    def read(i: int) -> None:
        while found := streams[i].recv(65536):
            heard[i] += len(found)

    streams = [socket.create_connection((place.hostname, place.port)) for _ in range(browsers)]
    readers = [threading.Thread(target=read, args=(i,)) for i in range(browsers)]
    for stream, reader in zip(streams, readers, strict=True):
        stream.sendall(f"GET {place.path} HTTP/1.1\r\nHost: {place.netloc}\r\n\r\n".encode())
        reader.start()
    yield heard
    for stream, reader in zip(streams, readers, strict=True):
        stream.shutdown(socket.SHUT_RDWR)
        reader.join()
        stream.close()


def _share(rig: PageRig, gateway: ChildProgram, browsers: int) -> tuple[float, float]:
    """Share of a core, and kB/s of each browser."""
    assert rig.web is not None
    channels = sorted({key for key, _ in recorded() if key.startswith("reading/")})
    with _hearing(rig.address.rstrip("/") + "/stream/mill", browsers) as heard:
        began, before = time.monotonic(), _core_s(rig.web.pid)
        for second in range(SECONDS):
            for key in channels:
                gateway.say(f"{key} {json.dumps({'value': 20.0 + 0.1 * (second % 7)})}")
            time.sleep(max(began + second + 1 - time.monotonic(), 0.0))
        lasted = time.monotonic() - began
        return (_core_s(rig.web.pid) - before) / lasted, sum(heard) / max(browsers, 1) / lasted / 1e3


def main() -> None:
    """Measure and print."""
    with TemporaryDirectory() as folder, page_rig() as rig:
        settings = Path(folder) / "web.toml"
        settings.write_text(MILL_SETTINGS, encoding="utf-8")
        gateway = played_mill(rig, settings)
        for _ in range(3):
            with rig.page("/machine/mill") as page:
                for stored in ("#day-parts th i", "#weeks tbody th", "#channels .spark path"):  # comes after the paint
                    page.locator(stored).first.wait_for(state="attached")
                size, painted_ms = page.evaluate(_VISIT)
                print(f"first visit: {size / 1e3:.0f} kB, first paint after {painted_ms:.0f} ms")
        for browsers in (0, BROWSERS):
            share, kb_s = _share(rig, gateway, browsers)
            print(f"{browsers} browsers: {100.0 * share:.1f} % of a core, {kb_s:.1f} kB/s to each")


if __name__ == "__main__":
    main()
