"""Runs in the guest under the package's Python: reaches the limits of the service's unit, and reports as JSON what
happened.

Each line: what was tried, whether it went as it should, what was seen.
"""

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from tests.benches import computer_files_guest
from tests.benches.guest_commands import DATA, PYTHON, GuestRow, run, until

UNIT = Path("/usr/lib/systemd/system/talc-gateway.service")
GROUP = Path("/sys/fs/cgroup/system.slice/talc-gateway.service")
RUN = Path("/run/systemd/system")
PROBE = '-c "from tests.benches.limits_probe import main; main()"'
"""Its work is a function of a module that another process can import."""
TOO_LITTLE_MB = 40
"""Less than the service has in use."""


def shown(name: str, unit: str = "talc-gateway") -> str:
    return run(f"systemctl show {unit} --property={name} --value")


def read(name: str) -> str:
    return (GROUP / name).read_text(encoding="ascii").strip()


def probe(name: str, work: str, lines: str = "") -> dict[str, float | str]:
    """What limits_probe.py says of its work, in a copy of the service's unit with these lines added."""
    unit = RUN / f"{name}.service"
    unit.write_text(UNIT.read_text(encoding="utf-8"), encoding="utf-8")
    own = f"-/sys/fs/cgroup/system.slice/{name}.service"
    drop_in = RUN / f"{name}.service.d"
    drop_in.mkdir(exist_ok=True)
    (drop_in / "probe.conf").write_text(
        f"[Service]\nType=oneshot\nRestart=no\nExecStart=\nExecStart={PYTHON} {PROBE} {work}\n"
        f"Environment=PYTHONPATH=/usr/local/lib\nReadWritePaths={own}\n{lines}\n",
        encoding="utf-8",
    )
    run(f"systemctl daemon-reload && systemctl start {name}")
    said = run(f"journalctl --sync; journalctl --boot --unit={name} --output=cat --no-pager | grep '^{{' | tail -n 1")
    found: dict[str, float | str] = json.loads(said)
    return found


def _groups() -> Iterator[GuestRow]:
    pid = shown("MainPID")
    inside = {name: read(f"{name}/cgroup.procs").split() for name in (".", "gateway", "learning")}
    yield (
        "the gateway is in its own control group",
        inside == {".": [], "gateway": [pid], "learning": []},
        str(inside),
    )
    weights = read("gateway/cpu.weight"), read("learning/cpu.weight")
    yield "the weights of the gateway and of what learns", weights == ("100", "10"), " and ".join(weights)
    said = run(
        "journalctl --sync; journalctl --boot --unit=talc-gateway --output=cat --no-pager | grep 'learning runs'"
    )
    yield "the service says so", "runs in its own control group" in said, said
    run("systemctl reload talc-gateway && systemctl restart talc-gateway")
    weights = read("gateway/cpu.weight"), read("learning/cpu.weight")
    yield "the same after a reload and a restart", weights == ("100", "10"), " and ".join(weights)


def _shares() -> Iterator[GuestRow]:
    """Three processes that learn, beside a gateway that computes as well, on one processor."""
    run("systemctl stop talc-gateway machine")
    grouped = float(probe("share-grouped", "share")["share"])
    alone = float(probe("share-nice", "share", "Delegate=no")["share"])
    run("systemctl start machine && systemctl start talc-gateway")
    yield "three processes that learn leave the gateway nine tenths", 0.87 < grouped < 0.95, f"{100 * grouped:.0f} %"
    yield "without the groups, only at nice 10, less", alone < grouped - 0.05, f"{100 * alone:.0f} %"


def _tasks() -> Iterator[GuestRow]:
    most, needed = int(shown("TasksMax")), int(read("pids.peak"))
    yield "the service needs less than half of its tasks", 2 * needed < most, f"{needed} of {most}"
    found = probe("tasks", "tasks")
    yield "more tasks than that are refused", found["tasks"] == most, f"{found['tasks']}, then {found['error']}"


def _memory() -> Iterator[GuestRow]:
    most, needed = int(shown("MemoryMax")) / 2**20, int(read("memory.peak")) / 2**20
    yield "the service needs less than half of its memory", 2 * needed < most, f"{needed:.0f} of {most:.0f} MiB"
    found = probe("hog", "hog")
    good = "SIGKILL" in str(found["error"]) and found["goes_on"] == 1
    yield "only the separate work that takes all memory ends, and it is reported", good, str(found["error"])
    restarts = int(shown("NRestarts"))
    run(f"systemctl set-property --runtime talc-gateway MemoryMax={TOO_LITTLE_MB}M MemorySwapMax=0")
    until(f"[ $(systemctl show talc-gateway --property=NRestarts --value) -gt {restarts} ]")
    log = "journalctl --sync; journalctl --boot --unit=talc-gateway --no-pager"
    told = run(f"{log} | grep -E 'oom|OOM' | tail -n 1 | cut -d: -f4-")
    run("systemctl set-property --runtime talc-gateway MemoryMax=1G")
    took_s = until("systemctl is-active --quiet talc-gateway")
    seen = f"{told.strip()}; running again after {took_s:.0f} s"
    yield "a gateway over its memory is killed, and started again", "oom" in told.lower(), seen
    run("systemctl stop talc-gateway")
    yield "the database after that", True, run(f"talc-gateway db check {DATA}/gateway.sqlite").splitlines()[-1]


PARTS: tuple[Callable[[], Iterator[GuestRow]], ...] = (_groups, _shares, _tasks, _memory)


def main() -> None:
    out = Path(sys.argv[1])

    def told(row: GuestRow) -> None:
        with out.open("a", encoding="utf-8") as lines:
            lines.write(json.dumps(row) + "\n")

    run("systemctl start machine && systemctl start talc-gateway")
    for part in (*PARTS, *computer_files_guest.PARTS):
        try:
            for row in part():
                told(row)
        except Exception as error:  # noqa: BLE001 - a row as well, and the next part is tried
            log = subprocess.run(["journalctl", "--boot", "-n", "40"], capture_output=True, text=True, check=False)
            told((f"{part.__name__.strip('_')}: it ran to its end", False, f"{error!r}\n{log.stdout}"))
    told(("everything was tried", True, ""))


if __name__ == "__main__":
    main()
