"""Runs in the guest under the package's Python: puts the files of deploy/pi where they belong, and sees what they do.

`tries` gives rows: what was tried, whether it went as it should, what was seen.
"""

import fcntl
import os
import re
import socket
import struct
import subprocess
import termios
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Thread

from tests.benches.guest_commands import CONFIG, DATA, LIMIT_S, GuestRow, run, until

SHARE = Path("/opt/talc-gateway/share/pi")
N_SLCAN, SIOCSIFNAME = 17, 0x8923
"""The kernel's line discipline for a CAN adapter behind a serial line; and how an interface gets another name."""
USB = "/sys/devices/pci0/usb1/1-1/1-1.2"
"""Where /dev/ttyUSB0 of the imitated adapter is plugged in, as the commented rule has it."""
FAKE_ADAPTER = f"""
mount -t tmpfs sys /sys
port={USB}/1-1.2:1.0/ttyUSB0
mkdir -p $port/tty/ttyUSB0 /sys/bus/usb-serial/drivers/ftdi_sio /sys/bus/usb /sys/class/tty
echo DEVTYPE=usb_device >{USB}/uevent; ln -s /sys/bus/usb {USB}/subsystem
echo DRIVER=ftdi_sio >$port/uevent; ln -s /sys/bus/usb-serial $port/subsystem; echo 16 >$port/latency_timer
ln -s /sys/bus/usb-serial/drivers/ftdi_sio $port/driver
printf 'MAJOR=188\\nMINOR=0\\nDEVNAME=ttyUSB0\\n' >$port/tty/ttyUSB0/uevent
ln -s /sys/class/tty $port/tty/ttyUSB0/subsystem
export SYSTEMD_DEVICE_VERIFY_SYSFS=0
for action in add bind; do udevadm test --action=$action $port 2>&1; done
udevadm test --action=add $port/tty/ttyUSB0 2>&1
"""
"""The files by which the kernel reports an FTDI adapter to udev; udev reads them as it would the kernel's."""


def placed(name: str, where: str, *changes: tuple[str, str]) -> None:
    """Copy a file to where its table in docs/install-pi.md says."""
    text = (SHARE / name).read_text(encoding="utf-8")
    for before, after in changes:
        if before not in text:
            raise ValueError(f"{name} has no {before!r}")
        text = text.replace(before, after)
    Path(where).parent.mkdir(parents=True, exist_ok=True)
    Path(where).write_text(text, encoding="utf-8")


def udev() -> Iterator[GuestRow]:
    name = "99-talc-gateway.rules"
    placed(name, f"/etc/udev/rules.d/{name}", ("#SUBSYSTEM", "SUBSYSTEM"))
    Path("/run/adapter.sh").write_text(FAKE_ADAPTER, encoding="utf-8")
    said = run("unshare --mount sh -e /run/adapter.sh")
    about = [line for line in said.splitlines() if name in line]
    times = sum("latency_timer' writing '1'" in line for line in about)
    yield "udev: an FTDI adapter holds nothing back, added or bound to its driver", times == 2, f"{times} times"
    link = re.search(r"^DEVLINKS=.*", said, re.M)
    named = link[0] if link else "no name"
    yield "udev: the commented rule names the USB socket", "/dev/talc-rs485" in named, named
    faults = [line for line in about if re.search("invalid|unknown|ignoring|fail", line, re.IGNORECASE)]
    yield "udev: no complaint about the file", about != [] and faults == [], "; ".join(faults) or "none"


def _listen(adapter: int, heard: bytearray) -> None:
    while said := os.read(adapter, 1000):
        heard += said


def _opened(heard: bytearray) -> bool:
    """Whether it hears, in time, of 125 kbit/s (S4 in CAN232 of Lawicel) and is opened (O)."""
    end_s = time.monotonic() + LIMIT_S
    while b"S4\rO\r" not in heard and time.monotonic() < end_s:
        time.sleep(0.1)
    return b"S4\rO\r" in heard


def networkd() -> Iterator[GuestRow]:
    """networkd sets the bit rate of an slcan adapter over its serial line. The adapter cannot obey one line of the
    file."""
    placed("80-can.network", "/etc/systemd/network/80-can.network", ("RestartSec=100ms\n", ""))
    run("modprobe slcan")
    adapter, line = os.openpty()
    for side in (adapter, line):
        raw = termios.tcgetattr(side)
        raw[0] = raw[1] = raw[3] = 0
        termios.tcsetattr(side, termios.TCSANOW, raw)
    before = set(Path("/sys/class/net").iterdir())
    fcntl.ioctl(line, termios.TIOCSETD, struct.pack("i", N_SLCAN))
    (made,) = set(Path("/sys/class/net").iterdir()) - before
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        fcntl.ioctl(any_socket, SIOCSIFNAME, struct.pack("16s16s", made.name.encode(), b"can0"))
    heard = bytearray()
    Thread(target=_listen, args=(adapter, heard), daemon=True).start()  # slcan waits until what it says is read
    run("ip link set can0 up type can bitrate 125000")
    yield "ip: the CAN adapter is opened at 125 kbit/s", _opened(heard), repr(bytes(heard))
    shown = run("ip -details -statistics link show can0")
    counted = "bitrate 125000" in shown and "error-pass" in shown
    yield "ip: it shows the rate and counts errors", counted, " ".join(shown.split())
    refused = subprocess.run(
        "ip link set can0 down && ip link set can0 type can restart-ms 100", shell=True, capture_output=True, text=True
    )
    yield "ip: an adapter with slcan refuses restart-ms", refused.returncode != 0, refused.stderr.strip()
    heard.clear()
    run("systemctl enable systemd-networkd && systemctl start systemd-networkd")
    until("networkctl --no-pager status can0 | grep -q 80-can.network && grep -q 1 /sys/class/net/can0/carrier")
    yield "networkd: the CAN adapter is opened at 125 kbit/s", _opened(heard), repr(bytes(heard))
    log = run("journalctl --boot --unit=systemd-networkd --priority=warning --no-pager")
    faults = [line for line in log.splitlines() if "80-can.network" in line]
    yield "networkd: no complaint about the file", faults == [], "; ".join(faults) or "none"


def chrony() -> Iterator[GuestRow]:
    where = "/etc/chrony/conf.d/talc-gateway.conf"
    placed("chrony-talc-gateway.conf", where, ("#server 192.168.1.1", "server 127.0.0.9"))
    read = run("chronyd -p").splitlines()
    wanted = {"server 127.0.0.9 iburst prefer", "makestep 1.0 3", "rtcsync", "driftfile /var/lib/chrony/chrony.drift"}
    yield "chrony: it reads every line of the file", wanted <= set(read), ", ".join(sorted(wanted & set(read)))
    run("systemctl restart chrony")
    sources = run("chronyc -n sources")
    yield "chrony: it asks the plant's server", "127.0.0.9" in sources, sources.splitlines()[-1]


def journald() -> Iterator[GuestRow]:
    placed("journald-volatile.conf", "/etc/systemd/journald.conf.d/talc-gateway.conf")
    run("systemctl restart systemd-journald && echo only in memory | systemd-cat -t talc-mark && journalctl --sync")
    found = {
        folder: run(f"journalctl --directory={folder} -t talc-mark --output=cat --no-pager -q || true")
        for folder in ("/run/log/journal", "/var/log/journal")
    }
    yield "journald: what is logged is only in memory", [*found.values()] == ["only in memory", ""], str(found)
    size = run("journalctl --boot --unit=systemd-journald --output=cat --no-pager | grep -o 'max [0-9.]*M' | tail -n 1")
    yield "journald: 64 MB of it at most", size == "max 64.0M", size


def kernel_log() -> Iterator[GuestRow]:
    """The commands of docs/install-pi.md find what the driver of a Pi's firmware logs about its supply."""
    Path("/dev/kmsg").write_text("<2>hwmon hwmon1: Undervoltage detected!\n", encoding="utf-8")
    run("journalctl --sync")
    found = run("journalctl -k --grep voltage")
    yield "journalctl: the kernel's log is searched", "Undervoltage detected!" in found, found.splitlines()[-1]


def read_only() -> Iterator[GuestRow]:
    """The root is read-only, the data is on a separate partition (a second disk), and the service runs on it."""
    boot = next(line for line in (SHARE / "fstab-read-only").read_text("utf-8").splitlines() if "REPLACE-01" in line)
    placed("fstab-read-only", "/etc/fstab", ("PARTUUID=REPLACE-02", "/dev/ubda"), (boot + "\n", ""))
    run("systemctl stop talc-gateway")
    run("mkfs.ext4 -q -L talc-data /dev/ubdb && udevadm settle && udevadm trigger --settle /dev/ubdb || true")
    run(f"mkdir -p /run/data && mount /dev/ubdb /run/data && cp -a {DATA}/. /run/data && umount /run/data")
    run(f"findmnt --verify; systemctl daemon-reload; mount --all && mount -o remount / && chown talc-gateway: {DATA}")
    refused = subprocess.run(["touch", "/etc/talc-gateway/new"], capture_output=True, text=True, check=False).stderr
    yield "fstab: the root is read-only", "Read-only file system" in refused, refused.strip()
    run("systemctl restart chrony talc-gateway")
    until(f"talc-gateway status --json {CONFIG} >/run/status; [ $? -le 3 ]")
    source = run(f"findmnt --noheadings --output SOURCE {DATA}")
    yield "fstab: the service and chrony run, with the database on the partition", source == "/dev/ubdb", source
    run("systemctl stop talc-gateway")
    said = run(f"talc-gateway db check {DATA}/gateway.sqlite").splitlines()[-1]
    yield "fstab: the database after that", True, said


PARTS: tuple[Callable[[], Iterator[GuestRow]], ...] = (
    udev,
    networkd,
    chrony,
    journald,
    kernel_log,
    read_only,
)
