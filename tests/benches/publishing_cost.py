"""Cost of publishing for the service: `python -m tests.benches.publishing_cost SECONDS`.

Three times `talc-gateway run` beside each other, each with its own emulated machine of 30 channels at 1 Hz, one sensor
of them at 10 Hz: without telemetry; publishing to a subscriber; and publishing, while Prometheus asks for `/metrics`
each 15 s. Whatever else the computer does is the same for all three. Prints each one's processor time, and how much
more than the first it took in each window.
"""

import os
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from statistics import median

import zenoh

from benchmarks.acquisition import bench_config, emulated_machine
from gateway.config.telemetry import Telemetry
from gateway.telemetry.session import page_config
from tests.benches.free_port import free_port

_READY_S, _SETTLED_S, _WINDOWS, _SCRAPED_S = 120.0, 15.0, 4, 15.0
NO_TELEMETRY, PUBLISHING, SCRAPED = "without telemetry", "publishing", "publishing, and /metrics"


def used(process: int) -> tuple[float, float, float]:
    """Processor time, s, resident memory, and what of it no other process shares, MB."""
    fields = Path(f"/proc/{process}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    kilobytes = {
        line.split(":")[0]: int(line.split()[1])
        for line in Path(f"/proc/{process}/smaps_rollup").read_text(encoding="ascii").splitlines()[1:]
    }
    own = kilobytes["Private_Clean"] + kilobytes["Private_Dirty"]
    cpu_s = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return cpu_s, kilobytes["Rss"] * 1.024e-3, own * 1.024e-3


@contextmanager
def service(folder: Path, title: str, stack: ExitStack) -> Iterator[tuple[int, str]]:
    """One service with its machine; its process, and where its metrics are."""
    port, metrics = free_port(), f"127.0.0.1:{free_port()}"
    file = bench_config(folder, stack.enter_context(emulated_machine(folder)), nc=False)
    text = file.read_text(encoding="utf-8")
    before, _, after = text.partition("[telemetry]\n")
    _, _, others = after.partition("\n\n")
    telemetry = "enabled = false\n" if title == NO_TELEMETRY else f'listen = ["tcp/127.0.0.1:{port}"]\n'
    served = f'[metrics]\nlisten = "{metrics}"\n' if title == SCRAPED else ""
    file.write_text(f"{before}[telemetry]\n{telemetry}{served}\n{others}", encoding="utf-8")
    with subprocess.Popen([sys.executable, "-m", "gateway", "run", str(file)]) as process:
        try:
            until_s = time.monotonic() + _READY_S
            while not (folder / "gateway.sqlite").exists():  # it stores when all else is there
                assert time.monotonic() < until_s, f"{file}: the service does not start"
                time.sleep(0.2)
            if title != NO_TELEMETRY:
                session = zenoh.open(page_config(Telemetry(listen=(), connect=(f"tcp/127.0.0.1:{port}",))))
                stack.callback(session.close)
                session.declare_subscriber("talc/**", lambda _: None)
            yield process.pid, metrics
        finally:
            process.terminate()


def main(seconds: float) -> None:
    """Prints a line for each service."""
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        running = dict[str, tuple[int, str]]()
        for number, title in enumerate((NO_TELEMETRY, PUBLISHING, SCRAPED)):
            folder = Path(name, str(number))
            folder.mkdir()
            running[title] = stack.enter_context(service(folder, title, stack))
        time.sleep(_SETTLED_S)
        shares: dict[str, list[float]] = {title: [] for title in running}
        for _ in range(_WINDOWS):
            began_s, before = time.monotonic(), {title: used(pid)[0] for title, (pid, _) in running.items()}
            while time.monotonic() - began_s < seconds / _WINDOWS:
                with urllib.request.urlopen(f"http://{running[SCRAPED][1]}/metrics") as answer:
                    assert b"talc_" in answer.read()
                time.sleep(min(_SCRAPED_S, seconds / _WINDOWS))
            took_s = time.monotonic() - began_s
            for title, (pid, _) in running.items():
                shares[title].append(100.0 * (used(pid)[0] - before[title]) / took_s)
        for title, (pid, _) in running.items():
            more = [own - bare for own, bare in zip(shares[title], shares[NO_TELEMETRY], strict=True)]
            _, whole_mb, own_mb = used(pid)
            print(
                f"{title:<26}{median(shares[title]):5.2f} % of a core, {median(more):+.2f} ({min(more):+.2f} to"
                f" {max(more):+.2f}) beside the first; {whole_mb:.0f} MB, {own_mb:.0f} of it its own"
            )


if __name__ == "__main__":
    main(float(sys.argv[1]))
