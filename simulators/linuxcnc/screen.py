#!/usr/bin/python3
"""The operator of LinuxCNC, started by it as its screen: commands on standard input, answers through TALC_SCREEN_FD.

One JSON object per line. LinuxCNC's programs write to the standard output of all at any moment, so answers have their
own pipe. Runs under the system's Python, which has LinuxCNC's modules; its end shuts LinuxCNC down.
"""

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import hal
import linuxcnc

_LIMIT_S = 60.0
_LOCKED_S = 1.0
"""A program that waits for HAL's lock for so long waits for ever."""
ARRIVED = 1e-7
"""An axis has arrived within this distance of its setpoint, in the machine's units or degrees."""
_LISTENS = "0A"
"""TCP_LISTEN in /proc/net/tcp."""


class ControlScreen:
    def __init__(self) -> None:
        self.command, self.stat, self.errors = linuxcnc.command(), linuxcnc.stat(), linuxcnc.error_channel()
        self.said: list[str] = []
        self.sampled: tuple[str, ...] = ()
        self.recorder: subprocess.Popen[bytes] | None = None
        self.sphere = _sphere() if Path("sphere.hal").exists() else None

    def until(self, what: str, condition: Any) -> None:
        """Wait for a state: an acknowledged command has not yet been carried out."""
        deadline = time.monotonic() + _LIMIT_S
        while True:
            self.stat.poll()
            if condition(self.stat):
                return
            if time.monotonic() > deadline:
                raise TimeoutError(f"{what}; the control says {self.messages()}")
            time.sleep(0.005)

    def switch_on(self) -> None:
        self.command.state(linuxcnc.STATE_ESTOP_RESET)
        self.until("emergency stop reset", lambda s: s.task_state == linuxcnc.STATE_ESTOP_RESET)
        self.command.state(linuxcnc.STATE_ON)
        self.until("machine on", lambda s: s.task_state == linuxcnc.STATE_ON)

    def home(self) -> None:
        self.command.mode(linuxcnc.MODE_MANUAL)
        self.until("manual mode", lambda s: s.task_mode == linuxcnc.MODE_MANUAL)
        self.command.teleop_enable(0)
        self.until("joint mode", lambda s: s.motion_mode == linuxcnc.TRAJ_MODE_FREE)
        self.command.home(-1)
        self.until("all joints homed", lambda s: all(s.homed[: s.joints]))

    def unhome(self) -> None:
        self.command.mode(linuxcnc.MODE_MANUAL)
        self.until("manual mode", lambda s: s.task_mode == linuxcnc.MODE_MANUAL)
        self.command.teleop_enable(0)
        self.until("joint mode", lambda s: s.motion_mode == linuxcnc.TRAJ_MODE_FREE)
        self.command.unhome(-1)
        self.until("no joint homed", lambda s: not any(s.homed[: s.joints]))

    def mdi(self, block: str) -> None:
        self.command.mode(linuxcnc.MODE_MDI)
        self.until("MDI mode", lambda s: s.task_mode == linuxcnc.MODE_MDI)
        self.command.mdi(block)
        if self.command.wait_complete(_LIMIT_S) != linuxcnc.RCS_DONE:
            raise RuntimeError(f"{block}: {self.messages()}")
        # A block is done when its last setpoint is planned; the interpolator reaches it some servo periods later.
        self.until("axes where the block sent them", _arrived)

    def send_mdi(self, block: str) -> None:
        """As another client of LinuxCNC does at any moment: without waiting, in whatever mode the control is."""
        self.command.mdi(block)

    def send_mode(self, mode: int) -> None:
        self.command.mode(mode)

    def send_off(self) -> None:
        self.command.state(linuxcnc.STATE_OFF)

    def send_abort(self) -> None:
        self.command.abort()

    def run(self, program: str) -> None:
        """Start a program; it goes on by itself."""
        self.command.mode(linuxcnc.MODE_AUTO)
        self.until("automatic mode", lambda s: s.task_mode == linuxcnc.MODE_AUTO)
        self.command.program_open(program)
        self.command.auto(linuxcnc.AUTO_RUN, 0)

    def resume(self) -> None:
        """Cycle start, after M0."""
        self.command.auto(linuxcnc.AUTO_RESUME)

    def abort(self) -> None:
        self.command.abort()
        self.until("idle", lambda s: s.interp_state == linuxcnc.INTERP_IDLE)

    def jog(self, speed: float) -> None:
        """X by hand, mm/s; 0 stops it."""
        self.command.mode(linuxcnc.MODE_MANUAL)
        self.until("manual mode", lambda s: s.task_mode == linuxcnc.MODE_MANUAL)
        self.command.teleop_enable(1)
        if speed:
            self.command.jog(linuxcnc.JOG_CONTINUOUS, False, 0, speed)
        else:
            self.command.jog(linuxcnc.JOG_STOP, False, 0)
        self.until("X as commanded", lambda s: bool(s.axis[0]["velocity"]) == bool(speed))

    def send_jog(self, speed: float, seconds: float) -> None:
        """X by hand for a while, mm/s, in whatever mode the control is."""
        self.command.teleop_enable(1)
        time.sleep(0.05)
        self.command.jog(linuxcnc.JOG_CONTINUOUS, False, 0, speed)
        time.sleep(seconds)
        self.command.jog(linuxcnc.JOG_STOP, False, 0)

    def listening(self, port: int) -> list[str]:
        """Listening addresses on this port, as the kernel writes them, in host byte order and hexadecimal."""
        rows = [
            row.split() for table in ("tcp", "tcp6") for row in Path(f"/proc/net/{table}").read_text().splitlines()[1:]
        ]
        local = [row[1].split(":") for row in rows if row[3] == _LISTENS]
        return [address for address, at in local if int(at, 16) == port]

    def greeting(self, port: int) -> str:
        """The agent's greeting to a connection from this computer."""
        with socket.create_connection(("127.0.0.1", port), _LIMIT_S) as line, line.makefile() as lines:
            return lines.readline()

    def freeze(self, name: str) -> None:
        """Freeze a part of LinuxCNC until `thaw`, as if its computer hung; returns when none of its threads runs.

        Never while it holds the lock of HAL, for which every other program would wait.
        """
        while True:
            processes = _signal(name, signal.SIGSTOP)
            # One thread takes the signal and stops the others: beside busy programs they run on until it has a core.
            deadline = time.monotonic() + _LIMIT_S
            while not all(map(_stopped, processes)):
                if time.monotonic() > deadline:
                    raise TimeoutError(f"{name} runs on")
                time.sleep(0.001)
            try:
                subprocess.run(["halcmd", "status", "lock"], capture_output=True, timeout=_LOCKED_S, check=True)
                return
            except subprocess.TimeoutExpired:
                self.thaw(name)

    def thaw(self, name: str) -> None:
        _signal(name, signal.SIGCONT)

    def kill_agent(self) -> None:
        """Kill it as the kernel does when memory runs out, without warning."""
        listed = re.search(r"^\s*\d+\s+User\s+talc\s+(\d+)", self.hal("show", "comp"), re.MULTILINE)
        if listed is None:
            raise RuntimeError("no component talc")
        os.kill(int(listed[1]), signal.SIGKILL)

    def deform(self, errors: list[float]) -> None:
        """Displace the sphere by these nine thermal errors from now on."""
        if self.sphere is None:
            raise RuntimeError("this machine has no sphere")
        self.sphere.deform(errors)

    def loosen(self, play_um: float) -> None:
        if self.sphere is None:
            raise RuntimeError("this machine has no sphere")
        self.sphere.loosen(play_um)

    def estop(self) -> None:
        self.command.state(linuxcnc.STATE_ESTOP)
        self.until("emergency stop", lambda s: s.task_state == linuxcnc.STATE_ESTOP)

    def messages(self) -> list[str]:
        """What LinuxCNC has reported to its operator since the last call."""
        self.listen()
        said, self.said = self.said, []
        return said

    def listen(self) -> None:
        """Read what LinuxCNC reports, as every screen does: its task stops for 5 s at the 26th unread message."""
        while (message := self.errors.poll()) is not None:
            self.said.append(message[1])

    def state(self) -> dict[str, Any]:
        self.stat.poll()
        return {
            "on": self.stat.task_state == linuxcnc.STATE_ON,
            "homed": list(self.stat.homed[: self.stat.joints]),
            "position": list(self.stat.joint_actual_position[: self.stat.joints]),
            "idle": self.stat.interp_state == linuxcnc.INTERP_IDLE,
            "paused": self.stat.interp_state == linuxcnc.INTERP_PAUSED,
            "turns": bool(self.stat.spindle[0]["enabled"]),
            "flood": bool(self.stat.flood),
            "mode": self.stat.task_mode,
            "tool": self.stat.tool_in_spindle,
            "tool_offset": list(self.stat.tool_offset[:3]),
            "g5x_index": self.stat.g5x_index,
            "g92": list(self.stat.g92_offset[:3]),
            "gcodes": sorted(self.stat.gcodes[1:]),
        }

    def modal(self) -> dict[str, Any]:
        """Everything that a later block depends on, as LinuxCNC reports it."""
        self.stat.poll()
        s = self.stat
        return {
            "gcodes": [code for i, code in enumerate(s.gcodes) if i not in (0, 2)],
            "mcodes": [code for i, code in enumerate(s.mcodes) if i not in (0, 1, 3)],
            "settings": list(s.settings[1:]),
            "tool": s.tool_in_spindle,
            "preselected": s.pocket_prepped,
            "tool_offset": list(s.tool_offset),
            "g5x": [s.g5x_index, *s.g5x_offset, s.rotation_xy],
            "g92": list(s.g92_offset),
            "overrides": [
                s.feed_override_enabled,
                s.feed_hold_enabled,
                s.adaptive_feed_enabled,
                *(spindle["override_enabled"] for spindle in s.spindle[: s.spindles]),
            ],
            "spindle": [[n["enabled"] and n["direction"], n["speed"]] for n in s.spindle[: s.spindles]],
            "coolant": [s.mist, s.flood],
        }

    def sample(self, count: int, *signals: str) -> list[list[float]]:
        """Values of the signals in `count` servo periods, one after the other: at most ten, the first time it is asked.

        The periods are the real-time thread's own, whatever else this computer does.
        """
        self._sampler(signals)
        with subprocess.Popen(["halsampler", "-n", str(count)], stdout=subprocess.PIPE, text=True) as reader:
            self.hal("setp", "sampler.0.enable", "1")
            rows = [[float(v) for v in line.split()] for line in reader.stdout or () if not line.startswith("overrun")]
            self.hal("setp", "sampler.0.enable", "0")
        return rows

    def record(self, *signals: str) -> None:
        """As `sample`, until `recorded`, while other commands are carried out. Returns when it records."""
        self._sampler(signals)
        rows = Path("recorded.txt")
        with rows.open("w") as file:
            self.recorder = subprocess.Popen(["halsampler"], stdout=file)
        self.hal("setp", "sampler.0.enable", "1")
        deadline = time.monotonic() + _LIMIT_S
        while not rows.stat().st_size:  # its first rows come together, some tens of servo periods later
            if time.monotonic() > deadline:
                raise TimeoutError("nothing is recorded")
            time.sleep(0.005)

    def recorded(self) -> list[list[float]]:
        self.hal("setp", "sampler.0.enable", "0")
        time.sleep(0.1)  # the reader looks at the queue 100 times a second
        if self.recorder is None:
            raise RuntimeError("nothing is recorded")
        self.recorder.terminate()
        self.recorder.wait()
        lines = Path("recorded.txt").read_text().splitlines()
        return [[float(v) for v in line.split()] for line in lines if not line.startswith("overrun")]

    def _sampler(self, signals: tuple[str, ...]) -> None:
        if self.sampled != signals:
            self.hal("loadrt", "sampler", "depth=4000", f"cfg={'f' * len(signals)}")
            for i, name in enumerate(signals):
                self.hal("net", name, "=>", f"sampler.0.pin.{i}")
            self.hal("setp", "sampler.0.enable", "0")
            self.hal("addf", "sampler.0", "servo-thread")
            self.sampled = signals

    def hal(self, *words: str) -> str:
        """As halcmd; a value is read here, as many are, and each halcmd is a program."""
        if len(words) == 2 and words[0] in ("getp", "gets"):
            value = hal.get_value(words[1])
            return str(value).upper() if isinstance(value, bool) else repr(value)
        done = subprocess.run(["halcmd", *words], capture_output=True, text=True, timeout=_LIMIT_S, check=False)
        if done.returncode:
            raise RuntimeError(f"halcmd {' '.join(words)}: {done.stderr.strip()}")
        return done.stdout.strip()


def _arrived(stat: Any) -> bool:
    return all(abs(set_ - is_) < ARRIVED for set_, is_ in zip(stat.position, stat.actual_position, strict=True))


def _signal(name: str, number: signal.Signals) -> list[int]:
    """Send the signal to every process of this name in this namespace; their numbers."""
    found = []
    for path in Path("/proc").glob("[0-9]*/comm"):
        with suppress(OSError):  # another process may end while this one reads
            if path.read_text().strip() == name:
                found.append(int(path.parent.name))
    if not found:
        raise RuntimeError(f"no process {name}")
    for pid in found:
        os.kill(pid, number)
    return found


def _stopped(process: int) -> bool:
    """Whether every thread of it is stopped by a signal."""
    states = set()
    for path in Path(f"/proc/{process}/task").glob("*/stat"):
        with suppress(OSError):  # a thread may end while this one reads
            states.add(path.read_text().rpartition(")")[2].split()[0])
    return states == {"T"}


def _sphere() -> Any:
    """The sphere's HAL component, by the sphere, tool and pivot of LinuxCNC's files; its code is beside this file."""
    sys.path.insert(0, str(Path.cwd()))
    from simulators.linuxcnc.sphere import Sphere

    talc = linuxcnc.ini("talc.ini")
    radius, height, x, y, z = (
        float(talc.find("TALC", name)) for name in ("SPHERE_RADIUS", "SPHERE_HEIGHT", "PIVOT_X", "PIVOT_Y", "PIVOT_Z")
    )
    length = re.search(r"^T99 .*\bZ(\S+)", Path("talc.tbl").read_text(), re.MULTILINE)
    sphere = Sphere(radius, height, [x, y, z + float(length[1] if length else 0)])
    subprocess.run(["halcmd", "-i", "talc.ini", "-f", "sphere.hal"], check=True)
    sphere.start()
    return sphere


VERBS = (
    "switch_on",
    "home",
    "unhome",
    "mdi",
    "send_mdi",
    "send_mode",
    "send_off",
    "send_abort",
    "modal",
    "run",
    "resume",
    "abort",
    "estop",
    "messages",
    "state",
    "hal",
    "sample",
    "record",
    "recorded",
    "jog",
    "send_jog",
    "listening",
    "greeting",
    "freeze",
    "thaw",
    "kill_agent",
    "deform",
    "loosen",
)


def main() -> None:
    component = hal.component("talc-screen")  # without one, no value can be read
    component.ready()
    control = ControlScreen()
    verbs = {name: getattr(control, name) for name in VERBS}
    try:
        with os.fdopen(int(os.environ["TALC_SCREEN_FD"]), "w") as answers:
            print(json.dumps({"ready": linuxcnc.version}), file=answers, flush=True)
            for line in sys.stdin:
                verb, *arguments = json.loads(line)
                try:
                    answer = {"answer": verbs[verb](*arguments)}
                    control.listen()
                except (KeyError, TypeError, RuntimeError, TimeoutError, linuxcnc.error) as error:
                    answer = {"error": repr(error)}
                print(json.dumps(answer), file=answers, flush=True)
    finally:  # also when nobody reads the answers any more: the sphere's thread would keep LinuxCNC running
        if control.sphere is not None:
            control.sphere.stop()
        component.exit()


main()
