"""Starts the real LinuxCNC with the files of deploy/nc/linuxcnc, headless, in separate namespaces.

The IPC namespace is separate because each holds only one LinuxCNC; the process and network namespaces are separate
because its stop script kills processes by name and its server uses a fixed port.
"""

import asyncio
import json
import os
import re
import shutil
import socket
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

from simulators.linuxcnc.component import MODULES, modules

_ROOT = Path(__file__).parents[2]
FILES = _ROOT / "deploy" / "nc" / "linuxcnc"
_HERE = Path(__file__).parent
APT_LINE = "apt-get install linuxcnc-uspace linuxcnc-uspace-dev"

MANUAL = 1
"""LinuxCNC's number of the mode in which an operator leaves it."""
HURRY: Mapping[str, object] = {
    "MAX_VELOCITY": 2000,
    "MAX_ACCELERATION": 200_000,
    "MAX_LINEAR_VELOCITY": 2000,
    "MAX_LINEAR_ACCELERATION": 200_000,
    "MAX_ANGULAR_VELOCITY": 2000,
    "MAX_ANGULAR_ACCELERATION": 200_000,
    "CYCLE_TIME": 0.001,
    "CLEAR": 3,
    "REACH": 1,
    "FINE_REACH": 0.05,
    "FIND_FEED": 600,
    "APPROACH_FEED": 20000,
    "DRY_FEED": 20000,
}
"""Settings of a machine with very high accelerations. A cycle still takes a quarter of a minute and more, because
touches stay slow."""

_NAMESPACES = ("--ipc", "--pid", "--mount", "--net", "--fork", "--mount-proc", "--kill-child")
_BEFORE_OTHERS = ("nice", "-n", "-10")
"""As a control's real time is. Where the user may not do that, `nice` says so and starts it all the same."""
_AS_ORDINARY_USER = ("--user", "--map-current-user", "--keep-caps")
"""Where the kernel lets unprivileged users create namespaces."""
_START = (
    f'ip link set lo up 2>/dev/null; mount --bind "$1/modules" {MODULES} && mount --bind "$1" /tmp && cd /tmp/nc '
    "&& exec linuxcnc -r /tmp/nc/talc.ini"
)
_REAL_TIME_USER = 65534
"""LinuxCNC's real-time part refuses root unless it is told which user it works for: `nobody`."""
_BOOT_S, _ANSWER_S, _STOP_S = 180.0, 90.0, 60.0
_LONGEST_ANSWER = 2**24
_MOTION_ANSWERS_S = 30.0
"""Without a real-time kernel, a busy computer lets LinuxCNC's motion controller wait; after 1 s it ends the program."""


class LinuxCncMachine:
    """What the operator can do at the control."""

    def __init__(self, process: asyncio.subprocess.Process, answers: asyncio.StreamReader, said: Path) -> None:
        """said: the file with what LinuxCNC's programs write."""
        self.process, self._answers, self._said = process, answers, said

    async def ask(self, verb: str, *arguments: str | float | list[float]) -> Any:
        """Run a command. Raises RuntimeError with the control's message."""
        if self.process.stdin is None:
            raise RuntimeError("LinuxCNC's process has no pipes")
        self.process.stdin.write(json.dumps([verb, *arguments]).encode() + b"\n")
        answer = await self.line(_ANSWER_S)
        if "error" in answer:
            raise RuntimeError(f"{verb} {arguments}: {answer['error']}")
        return answer["answer"]

    async def number(self, kind: str, name: str) -> float:
        """A HAL pin (getp) or signal (gets)."""
        return float(await self.ask("hal", kind, name))

    async def sees(self, **wanted: object) -> bool:
        """Whether the control's state has these values."""
        state = await self.ask("state")
        return all(state[name] == value for name, value in wanted.items())

    async def line(self, timeout_s: float) -> dict[str, Any]:
        """The operator's next line. Raises ConnectionError with what LinuxCNC wrote when it ends."""
        async with asyncio.timeout(timeout_s):
            line = await self._answers.readline()
        if not line:
            raise ConnectionError(f"LinuxCNC has ended:\n{self._said.read_text(errors='replace')}")
        answer: dict[str, Any] = json.loads(line)
        return answer


def missing() -> str | None:
    """Why LinuxCNC cannot run here, and what to do; None if it can."""
    if not FILES.is_dir():
        return f"{FILES} is missing: run this from the source tree"
    for program in ("linuxcnc", "halcompile"):
        if shutil.which(program) is None:
            return f"LinuxCNC's {program} is not installed here. Debian 12 or later has it: {APT_LINE}"
    return None


@asynccontextmanager
async def machine(
    folder: Path,
    agent: socket.socket | None = None,
    key: str = "",
    *,
    sphere: bool = False,
    settings: Mapping[str, object] | None = None,
    tools: str | None = None,
    coordinates: str = "XYZAC",
) -> AsyncIterator[LinuxCncMachine]:
    """LinuxCNC from ready until it has shut itself down.

    folder: an empty one; becomes its /tmp. key: what the agent shares with its client; empty: no agent. agent: a
    listening socket of this process for it, as LinuxCNC runs in a network of its own. sphere: with the emulated
    machine's sphere under the probe. settings: other values in the INI file, by key, in whichever section. tools:
    another tool table. coordinates: the axis of each joint, one letter twice for a gantry. Raises OSError when
    `missing` says something.
    """
    if (problem := missing()) is not None:
        raise OSError(problem)
    root = os.geteuid() == 0
    if root:
        os.chown(folder, _REAL_TIME_USER, -1)
    nc = folder / "nc"
    modules(folder / "modules", FILES)
    shutil.copytree(FILES, nc, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(_HERE / "screen.py", nc)
    (nc / "screen.py").chmod(0o755)
    changed = {"DISPLAY": "/tmp/nc/screen.py", "COMM_TIMEOUT": _MOTION_ANSWERS_S, **(settings or {})}
    if key:
        changed["# HALFILE"] = "talc_agent.hal"
        (nc / "talc.key").write_text(key)
        (nc / "talc.key").chmod(0o600)
    if sphere:
        _bring_sphere(nc)
    (nc / "talc.ini").write_text(_with(changed, _arranged(coordinates, (nc / "talc.ini").read_text())))
    if tools is not None:
        (nc / "talc.tbl").write_text(tools)
    environment = {"PATH": os.environ["PATH"], "HOME": "/tmp"}
    if root:
        environment["RTAPI_UID"] = str(_REAL_TIME_USER)
    if agent is not None:
        environment["TALC_AGENT_FD"] = str(agent.fileno())
    said = folder / "said.txt"
    ours, theirs = socket.socketpair()
    environment["TALC_SCREEN_FD"] = str(theirs.fileno())
    with theirs, said.open("wb") as output:
        process = await asyncio.create_subprocess_exec(
            *_BEFORE_OTHERS,
            "unshare",
            *(() if root else _AS_ORDINARY_USER),
            *_NAMESPACES,
            *("sh", "-c", _START, "sh", str(folder)),
            stdin=asyncio.subprocess.PIPE,
            stdout=output,
            stderr=asyncio.subprocess.STDOUT,
            env=environment,
            pass_fds=(theirs.fileno(),) if agent is None else (theirs.fileno(), agent.fileno()),
        )
    answers, line = await asyncio.open_connection(sock=ours, limit=_LONGEST_ANSWER)
    try:
        it = LinuxCncMachine(process, answers, said)
        await it.line(_BOOT_S)
        _prefer_real_time(process.pid)
        yield it
    finally:
        await _end(process)
        line.close()


def _prefer_real_time(pid: int) -> None:
    """Let the real time of the LinuxCNC below a process come before all other programs, where the user may do that:
    among busy ones it otherwise waits for a third of its periods, and falls behind."""
    for child in _children(pid):
        with suppress(OSError):  # no right to do that, or it has just ended
            if Path(f"/proc/{child}/comm").read_text() == "rtapi_app\n":
                for thread in Path(f"/proc/{child}/task").iterdir():
                    os.sched_setscheduler(int(thread.name), os.SCHED_RR, os.sched_param(1))
        _prefer_real_time(int(child))


def _children(pid: int) -> list[str]:
    """Of a process that may just have ended."""
    try:
        return Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except OSError:
        return []


async def _end(process: asyncio.subprocess.Process) -> None:
    if process.stdin is not None:
        process.stdin.close()
    try:
        async with asyncio.timeout(_STOP_S):
            await process.wait()
    except TimeoutError:
        process.kill()  # this process alone: the kernel ends its namespace with it
        await process.wait()


def _with(changed: Mapping[str, object], ini: str) -> str:
    """The file with other values. Raises ValueError for a key that the file does not have."""
    for key, value in changed.items():
        ini, count = re.subn(rf"(?m)^{key} = .*$", f"{key.removeprefix('# ')} = {value}", ini)
        if count == 0:
            raise ValueError(f"settings: {key} is not in talc.ini")
    return ini


def _arranged(coordinates: str, ini: str) -> str:
    """The file with the joints in another order, each as the file describes the joint of its axis."""
    before = "XYZAC"
    if coordinates == before:
        return ini
    blocks = re.split(r"(?m)^(?=\[)", ini)
    joints = {axis: next(b for b in blocks if b.startswith(f"[JOINT_{n}]")) for n, axis in enumerate(before)}
    others = [block for block in blocks if block not in joints.values()]
    arranged = [
        joints[axis].replace(joints[axis].split("]")[0], f"[JOINT_{n}", 1) for n, axis in enumerate(coordinates)
    ]
    changed = {
        "KINEMATICS": f"xyzac-trt-kins sparm=identityfirst coordinates={coordinates}",
        "JOINTS": len(coordinates),
        "COORDINATES": coordinates,
    }
    return _with(changed, "".join([*others, "\n", *arranged]))


def _bring_sphere(nc: Path) -> None:
    """What the sphere needs of our code, and a part program that touches it, beside LinuxCNC's files: its Python is not
    ours and sees no other folder."""
    for name in ("sphere.hal", "look.ngc"):
        shutil.copy(_HERE / name, nc)
    (nc / "simulators" / "linuxcnc").mkdir(parents=True)
    for name in ("__init__.py", "linuxcnc/__init__.py", "linuxcnc/sphere.py", "linuxcnc/chain.py"):
        shutil.copy(_HERE.parent / name, nc / "simulators" / name)
