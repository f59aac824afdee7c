"""Runs in the guest under the package's Python: the emulated machine at real speed, and a configuration that fits it.

Notifies systemd when both are there, and ends on a signal.
"""

import json
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

from simulators.bench import gateway_toml
from simulators.clock import SharedClock

HOURS = 24.0
FOLDER, CONFIG = Path("/run/machine"), Path("/etc/talc-gateway/gateway.toml")
CHANGED = {
    # The ramp at a stop begins from an offset that was put into K0.
    'route = "errors"': 'tables = {XY = 0, XZ = 1, YX = 2, YZ = 3, ZX = 4, ZY = 5}\nroute = "k0_slope"',
    "period_s = 100.0": "period_s = 1.0",  # the bench's are for simulated time
    "period_s = 30.0": "period_s = 1.0",
    "watchdog_s = 3600.0": "watchdog_s = 10.0",
}


def main() -> None:
    FOLDER.mkdir(exist_ok=True)
    epoch = datetime.now(UTC)
    clock = SharedClock(FOLDER / "clock", epoch=epoch, owner=True)
    clock.start()
    machine = subprocess.Popen(
        [sys.executable, "-m", "simulators.bench", str(FOLDER), epoch.isoformat(), "1", "1", str(HOURS), "k0"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    if machine.stdout is None:
        raise RuntimeError("the machine's process has no pipe")
    addresses: dict[str, str | int] = json.loads(machine.stdout.readline())
    for place in addresses.values():
        if isinstance(place, str):
            Path(place).chmod(0o666)  # on a real computer the group dialout has the serial ports
    fillings = {**addresses, "folder": "/var/lib/talc-gateway", "zenoh_port": 7447, "zenoh_connect": "[]", "talc": ""}
    text = gateway_toml(fillings)
    for before, after in CHANGED.items():
        text = text.replace(before, after)
    CONFIG.write_text(text, encoding="utf-8")
    subprocess.run(["systemd-notify", "--ready"], check=True)
    machine.wait()


if __name__ == "__main__":
    main()
