"""`python -m tests.benches.service_under_systemd PACKAGE`: the installed service under a systemd that has booted.

Makes a minimal Debian, boots it in a container, installs the package there without a network, and lets the service run
against the emulated machine on all its wires. Prints a table of what was tried. As root; needs mmdebstrap and
systemd-container.
"""

import json
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from shutil import copy
from subprocess import run
from typing import Any

from tests.benches.bad_packages import bad_packages
from tests.benches.booted_debian import BootedDebian, minimal_debian

HERE = Path(__file__).parent
CONFIG = "/etc/talc-gateway/gateway.toml"
PYTHON = "/opt/talc-gateway/bin/python"
PACKAGES = "packages"
"""The guest's folder of packages, below its root."""
UNIT = "/usr/lib/systemd/system/talc-gateway.service"
UNITS = {
    "machine": f"Type=notify\nNotifyAccess=all\nExecStart={PYTHON} /usr/local/lib/systemd_guest.py",
    # Neither touches the clock (-x): the guest's is this computer's.
    "time-server": "ExecStart=/usr/sbin/chronyd -x -d -u root -f /etc/time-server.conf",
    "time-client": "ExecStart=/usr/sbin/chronyd -x -d -u root -f /etc/time-client.conf",
}
TIME_SERVER = "local stratum 5\nport 11123\ncmdport 0\nallow all\npidfile /run/time-server.pid\n"
TIME_CLIENT = "server 127.0.0.1 port 11123 iburst minpoll -2 maxpoll 0\npidfile /run/time-client.pid\n"
PUBLIC_ON_LOOPBACK = """
import fcntl, socket, struct
address = struct.pack("16sHH4s8x", b"lo:1", socket.AF_INET, 0, socket.inet_aton("203.0.113.1"))
fcntl.ioctl(socket.socket(), 0x8916, address)
"""
"""SIOCSIFADDR."""
SHORT_STOP_S = 10
"""The stop timeout of a unit that would not wait for the ramp."""
ALLOWED = ("write to its own folder", "read its credential", "send to its own computer")


@dataclass(frozen=True, slots=True)
class SystemdPace:
    """How long systemd waits (None: as the unit file says), and how long the ramp at a stop takes."""

    watchdog_s: float | None = None
    restart_s: float | None = None
    in_force_um: int = 100
    """The offset that is in force at a stop, in whole µm: as many seconds, as the gateway moves offsets by 1 µm/s."""

    def text(self) -> str:
        """The text of a drop-in."""
        lines = ["[Service]"]
        lines += [] if self.watchdog_s is None else [f"WatchdogSec={self.watchdog_s}"]
        lines += [] if self.restart_s is None else [f"RestartSec={self.restart_s}"]
        return "\n".join(lines) + "\n"


@dataclass(frozen=True, slots=True)
class TriedUnit:
    """One row: what was tried, whether it went as it should, and what was seen."""

    what: str
    good: bool
    seen: str


def furnish(root: Path, package: Path, pace: SystemdPace) -> None:
    """Put everything that the guest needs besides the package into its folder."""
    packages = root / PACKAGES
    packages.mkdir(exist_ok=True)
    copy(package, packages / "talc-gateway.deb")
    for name in ("systemd_guest.py", "systemd_probe.py", "systemd_offset.py"):
        copy(HERE / name, root / "usr/local/lib" / name)
    for name, text in UNITS.items():
        (root / f"etc/systemd/system/{name}.service").write_text(f"[Service]\n{text}\n", encoding="utf-8")
    (root / "etc/time-server.conf").write_text(TIME_SERVER, encoding="utf-8")
    (root / "etc/time-client.conf").write_text(TIME_CLIENT, encoding="utf-8")
    drop_in = root / "etc/systemd/system/talc-gateway.service.d/pace.conf"
    drop_in.parent.mkdir()
    drop_in.write_text(pace.text(), encoding="utf-8")


def tries(guest: BootedDebian, pace: SystemdPace) -> Iterator[TriedUnit]:
    """Everything in its order, each row as soon as it is known."""
    guest.run(f"dpkg --install /{PACKAGES}/talc-gateway.deb")
    guest.run("systemctl start time-client machine")
    yield _ramp(guest, pace.in_force_um)
    guest.run("systemctl enable --now talc-gateway-web")  # before the gateway: the order does not matter
    yield from _start(guest)
    yield _page(guest)
    yield _room(guest)
    yield from _clock(guest)
    yield from _journal(guest)
    yield from _filters(guest)
    yield from _watchdog(guest)
    yield from _restarts(guest)
    yield from _stop(guest)
    yield _refused(guest)


def shown(guest: BootedDebian, *names: str) -> dict[str, str]:
    """Properties of the service."""
    text = guest.run(f"systemctl show talc-gateway --property={','.join(names)}")
    return dict(line.split("=", 1) for line in text.splitlines())


def _start(guest: BootedDebian) -> Iterator[TriedUnit]:
    began = guest.run(
        "systemctl enable --now talc-gateway && systemctl show talc-gateway --property=StatusText --value"
    )
    yield TriedUnit("Type=notify: start returns when it is ready", "machine bench" in began, began.strip())
    enabled = guest.run("systemctl is-enabled talc-gateway").strip()
    yield TriedUnit("it starts with the computer", enabled == "enabled", enabled)
    status = _until_read(guest)
    good = [name for name, reading in status["readings"].items() if reading[2] == "good"]
    yield TriedUnit(
        "every wire is read under the filters", status["running"] and len(good) == 30, f"{len(good)} channels"
    )
    text = guest.run("systemd-analyze security talc-gateway.service --no-pager | tail -n 1")
    exposure = float(text.partition("talc-gateway.service:")[2].split()[0])
    yield TriedUnit("systemd-analyze security, of the running unit", exposure <= 2.0, f"{exposure}")


def _page(guest: BootedDebian) -> TriedUnit:
    """The page for operators, by its own unit and under its filters; it can write nowhere."""
    fetch = "from urllib.request import urlopen; print(urlopen('http://127.0.0.1:8080/', timeout=30).status)"
    status = guest.run(f'/opt/talc-gateway/bin/python -c "{fetch}"').strip()
    properties = "systemctl show talc-gateway-web --property=ActiveState,NRestarts,DynamicUser --value"
    state = guest.run(properties).split()
    good = status == "200" and sorted(state) == ["0", "active", "yes"]
    return TriedUnit("the page is there, started before the gateway", good, f"{status} {' '.join(state)}")


def _ramp(guest: BootedDebian, in_force_um: int) -> TriedUnit:
    """The first run finds an offset in force and is stopped at once, by a unit that would kill it sooner."""
    guest.run(f"{PYTHON} /usr/local/lib/systemd_offset.py begin {in_force_um}")
    drop_in = "/run/systemd/system/talc-gateway.service.d"
    guest.run(f"mkdir -p {drop_in} && printf '[Service]\\nTimeoutStopSec={SHORT_STOP_S}\\n' >{drop_in}/short.conf")
    guest.run("systemctl daemon-reload && systemctl start talc-gateway")
    took_s = guest.wait_until("systemctl stop talc-gateway")
    result = shown(guest, "Result")["Result"]
    guest.run(f"rm {drop_in}/short.conf && systemctl daemon-reload")
    seen = json.loads(guest.run(f"{PYTHON} /usr/local/lib/systemd_offset.py end"))
    good = (
        (result, seen["last_um"], seen["left_um"]) == ("success", 0.0, 0.0)
        and seen["before_um"] > SHORT_STOP_S * seen["slew_um"]
        and seen["largest_step_um"] <= seen["slew_um"] + 1e-6
    )
    return TriedUnit(
        "at stop the offsets in force ramp to zero, and systemd waits",
        good,
        f"{result}: {seen['before_um']:.0f} µm in {seen['steps']} steps of at most {seen['largest_step_um']:.2f} µm to "
        f"{seen['left_um']:g} µm on the control, in {took_s:.0f} s (TimeoutStopSec {SHORT_STOP_S} s)",
    )


def _room(guest: BootedDebian) -> TriedUnit:
    """What the service has needed at most, beside the limits of its unit."""
    limits = shown(guest, "MainPID", "MemoryMax", "TasksMax", "LimitNOFILE")
    status = guest.run(f"cat /proc/{limits['MainPID']}/status")
    peak_mb, threads = (int(_field(status, name)) for name in ("VmHWM", "Threads"))
    peak_mb //= 1024
    most_mb = int(limits["MemoryMax"]) // 2**20
    descriptors = int(guest.run(f"ls /proc/{limits['MainPID']}/fd | wc -l"))
    most = int(limits["TasksMax"]), int(limits["LimitNOFILE"])
    return TriedUnit(
        "it needs less than half of what its limits allow",
        2 * peak_mb < most_mb and 2 * threads < most[0] and 2 * descriptors < most[1],
        f"{peak_mb} of {most_mb} MB, {threads} of {most[0]} threads, {descriptors} of {most[1]} descriptors",
    )


def _field(status: str, name: str) -> str:
    return status.partition(f"{name}:")[2].split()[0]


def _until_read(guest: BootedDebian) -> Any:
    """The service's status once every channel was read; exit code 3, as nothing has been decided yet."""
    whole = f"talc-gateway status --json {CONFIG} >/tmp/status; [ $? -le 3 ] && ! grep -q not.read /tmp/status"
    guest.wait_until(f'{whole} && {PYTHON} -c \'import json; assert not json.load(open("/tmp/status"))["missing"]\'')
    return json.loads(guest.run("cat /tmp/status"))


def _clock(guest: BootedDebian) -> Iterator[TriedUnit]:
    log = "journalctl --boot --unit=talc-gateway --no-pager"
    guest.wait_until(f"{log} | grep -q 'clock is not synchronised'")
    guest.run("systemctl start time-server")
    guest.wait_until(f"{log} | grep -q 'clock: synchronised'")
    yield TriedUnit("ProtectClock=yes: chrony tells of the clock", True, "not synchronised, then synchronised")
    done = guest.tried(f"talc-gateway doctor {CONFIG}")
    yield TriedUnit("doctor", done.returncode in (0, 3), done.stdout.strip().splitlines()[0])


def _journal(guest: BootedDebian) -> Iterator[TriedUnit]:
    """The journal as docs/install-pi.md shows it: what the gateway will do; and as warnings only both ends of a
    fault."""
    whole = guest.run("journalctl -u talc-gateway").splitlines()
    warned = guest.run("journalctl -u talc-gateway -p warning").splitlines()
    what = [line for line in whole if "machine bench" in line]
    yield TriedUnit("journalctl -u says what the gateway will do", what != [], what[0] if what else "nothing")
    ends = [any(text in line for line in warned) for text in ("clock is not synchronised", "clock: synchronised")]
    good = all(ends) and set(warned) < set(whole) and "machine bench" not in "".join(warned)
    yield TriedUnit("journalctl -p warning shows a fault and its end", good, f"{len(warned)} of {len(whole)} lines")


def _filters(guest: BootedDebian) -> Iterator[TriedUnit]:
    guest.run(
        "install -d -m 700 /etc/talc-gateway/secrets && umask 77 && echo pw >/etc/talc-gateway/secrets/nc-password"
    )
    guest.run("mknod /dev/unlisted c 10 229 && chmod 666 /dev/unlisted")
    guest.run(f"{PYTHON} -c '{PUBLIC_ON_LOOPBACK}'")
    folder = "/run/systemd/system"
    guest.run(f"mkdir -p {folder}/talc-probe.service.d && cp {UNIT} {folder}/talc-probe.service")
    text = (
        f"[Service]\\nType=oneshot\\nRestart=no\\nExecStart=\\nExecStart={PYTHON} /usr/local/lib/systemd_probe.py\\n"
        "LoadCredential=nc-password:/etc/talc-gateway/secrets/nc-password\\n"
    )
    guest.run(f"printf '{text}' >{folder}/talc-probe.service.d/probe.conf && systemctl daemon-reload")
    guest.run("systemctl start talc-probe")
    found = json.loads(guest.run("journalctl --boot --unit=talc-probe --output=cat --no-pager | grep '^{'"))
    free = json.loads(guest.run(f"{PYTHON} /usr/local/lib/systemd_probe.py"))
    denied = [what for what, happened in free.items() if happened != "done" and what != "read its credential"]
    yield TriedUnit("root outside the unit may do all of the following", not denied, ", ".join(denied) or "done")
    for what, happened in found.items():
        yield TriedUnit(
            f"{'may' if what in ALLOWED else 'may not'} {what}", (happened == "done") == (what in ALLOWED), happened
        )


def _watchdog(guest: BootedDebian) -> Iterator[TriedUnit]:
    before = shown(guest, "MainPID", "NRestarts", "WatchdogUSec")
    guest.run(f"kill -STOP {before['MainPID']}")
    took_s = guest.wait_until(_running_again(int(before["NRestarts"])))
    told = guest.run("journalctl --boot --unit=talc-gateway --no-pager | grep -c 'Watchdog timeout'").strip()
    seen = f"ended and running again after {took_s:.0f} s (WatchdogSec {before['WatchdogUSec']})"
    yield TriedUnit("a stopped process (SIGSTOP) is replaced", told != "0", seen)


def _running_again(restarts: int) -> str:
    later = f"[ $(systemctl show talc-gateway --property=NRestarts --value) -gt {restarts} ]"
    return f"{later} && systemctl is-active --quiet talc-gateway"


def _restarts(guest: BootedDebian) -> Iterator[TriedUnit]:
    before = shown(guest, "MainPID", "NRestarts", "RestartUSec")
    guest.run(f"kill -KILL {before['MainPID']}")
    took_s = guest.wait_until(_running_again(int(before["NRestarts"])))
    yield TriedUnit(
        "a killed process comes back once",
        int(shown(guest, "NRestarts")["NRestarts"]) == int(before["NRestarts"]) + 1,
        f"after {took_s:.0f} s (RestartSec {before['RestartUSec']})",
    )
    guest.run("for i in 1 2 3; do systemctl restart talc-gateway || exit 1; done")
    after = shown(guest, "NRestarts", "ActiveState", "Result")
    good = (after["ActiveState"], after["Result"]) == ("active", "success")
    yield TriedUnit("three restarts in a row", good, f"{after['ActiveState']}, {after['Result']}")


def _stop(guest: BootedDebian) -> Iterator[TriedUnit]:
    took_s = guest.wait_until("systemctl stop talc-gateway")
    log = guest.run(
        "journalctl --boot --unit=talc-gateway --output=cat --no-pager | grep -E 'stopping; this' | tail -n 1"
    )
    asked_s = float(log.rsplit("up to ", 1)[1].split()[0])
    result = shown(guest, "Result")["Result"]
    yield TriedUnit(
        "it stops within the time it asks for",
        result == "success",  # systemd would have killed it
        f"{took_s:.0f} s of {asked_s:.0f} s",
    )
    checked = guest.run("talc-gateway db check /var/lib/talc-gateway/gateway.sqlite").strip().splitlines()[-1]
    yield TriedUnit("the database after all this", True, checked)


def _refused(guest: BootedDebian) -> TriedUnit:
    guest.run(f'cp {CONFIG} /tmp/good.toml && sed -i \'s/^mode = "compensate"/mode = "wrong"/\' {CONFIG}')
    failed = guest.tried("systemctl start talc-gateway")
    after = shown(guest, "ActiveState", "SubState", "ExecMainStatus", "NRestarts")
    guest.run(f"cp /tmp/good.toml {CONFIG}; systemctl reset-failed talc-gateway")
    good = failed.returncode != 0 and (after["ActiveState"], after["ExecMainStatus"]) == ("failed", "2")
    return TriedUnit(
        "an invalid configuration is not tried again", good, f"exit code {after['ExecMainStatus']}, {after['SubState']}"
    )


def upgrades(guest: BootedDebian) -> Iterator[TriedUnit]:
    """Bad packages, and a good one after them: some minutes."""
    guest.run("systemctl start talc-gateway")
    failed = guest.tried(f"dpkg --install /{PACKAGES}/ends.deb")
    version, state = guest.run("cat /opt/talc-gateway/version").strip(), shown(guest, "ActiveState")["ActiveState"]
    told = [line for line in failed.stderr.splitlines() if "was not taken into use" in line]
    good = failed.returncode != 0 and (version, state) != ("99", "failed") and state == "active" and len(told) == 1
    yield TriedUnit("a newer program that ends itself is taken back", good, "; ".join(told))
    kept = guest.run("ls /var/lib/talc-gateway /opt").split()
    checked = guest.run("talc-gateway db check /var/lib/talc-gateway/gateway.sqlite").strip().splitlines()[-1]
    as_before = "gateway.sqlite.failed-upgrade" in kept and "talc-gateway.earlier" not in kept
    yield TriedUnit("its migration of the database too", as_before and checked.endswith("whole"), checked)
    again = guest.tried("dpkg --configure talc-gateway")
    said = again.stderr.strip().splitlines()[0]
    yield TriedUnit("dpkg --configure does not take it for installed", again.returncode != 0, said)
    guest.run(f"dpkg --install /{PACKAGES}/talc-gateway.deb")
    guest.wait_until("systemctl is-active --quiet talc-gateway")
    version, left = guest.run("cat /opt/talc-gateway/version").strip(), guest.run("ls /opt").split()
    restarts = shown(guest, "NRestarts")["NRestarts"]
    good = (version != "99", left, restarts) == (True, ["talc-gateway"], "0")
    yield TriedUnit("a package that works is taken into use", good, f"version {version}, NRestarts {restarts}")
    yield _silent(guest)


def _silent(guest: BootedDebian) -> TriedUnit:
    """Runs on a grid of some seconds, because the service must have been well, with a decision, before it is
    upgraded."""
    short = "s/^step_s = .*/step_s = 30.0/; s/^lead_s = .*/lead_s = 10.0/; s/gateway[.]sqlite/short.sqlite/"
    guest.run(f"sed -i '{short}' {CONFIG} && systemctl restart talc-gateway")
    guest.wait_until(f"talc-gateway status {CONFIG}")
    failed = guest.tried(f"dpkg --install /{PACKAGES}/silent.deb")
    version, state = guest.run("cat /opt/talc-gateway/version").strip(), shown(guest, "ActiveState")["ActiveState"]
    told = [line for line in failed.stderr.splitlines() if "was not taken into use" in line]
    guest.wait_until(f"talc-gateway status {CONFIG}")
    good = (
        (failed.returncode != 0, version != "99", state, len(told)) == (True, True, "active", 1)
        and "was good before the upgrade and is not any more" in told[0]
        and "channels: 0 of 30 good" in failed.stderr
    )
    seen = "; ".join(told) or failed.stderr.strip()[-500:]
    return TriedUnit("a newer program that runs and reads nothing is taken back", good, seen)


def main() -> None:
    """Print the table; exit code 1 if something did not go as it should."""
    package = Path(sys.argv[1]).resolve()
    bad = 0
    with tempfile.TemporaryDirectory(dir="/var/tmp") as name:
        root = minimal_debian(Path(name) / "root")
        pace = SystemdPace()
        furnish(root, package, pace)
        contents = Path(name) / "contents"
        run(["dpkg-deb", "--raw-extract", package, contents], check=True)
        bad_packages(contents, root / PACKAGES)
        print("| tried | | seen |\n|---|---|---|")
        with BootedDebian(root, Path(name) / "console") as guest:
            for row in chain(tries(guest, pace), upgrades(guest)):
                print(f"| {row.what} | {'as it should' if row.good else 'NO'} | {row.seen} |", flush=True)
                bad += not row.good
        run(["rm", "-rf", root], check=True)
    sys.exit(bool(bad))


if __name__ == "__main__":
    main()
