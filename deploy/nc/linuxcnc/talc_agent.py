#!/usr/bin/python3
"""The gateway's agent on LinuxCNC: reports the control's state, requests probing cycles, passes offsets to HAL.

A HAL component named talc, started by talc_agent.hal under the system's Python. The watchdog over the gateway's
heartbeat is not here but in real time, in that file: a killed agent sends no more beats.
"""

import math
import os
import signal
import socket
import time
from pathlib import Path
from typing import Any

import hal
import linuxcnc
from talc_cycle import POSES, Cycle
from talc_server import Refusal, Server, read_key

AXES = "xyz"
ALL_AXES = "XYZAC"
MODES = {linuxcnc.MODE_MANUAL: "jog", linuxcnc.MODE_AUTO: "auto", linuxcnc.MODE_MDI: "mda"}
SECONDS, FROZEN_S = 42, 2.0
"""Analog input with the seconds of real time, see talc_agent.hal; unchanged for this long, it is stale."""
PROGRAM = {
    linuxcnc.INTERP_IDLE: "stopped",
    linuxcnc.INTERP_READING: "running",
    linuxcnc.INTERP_WAITING: "running",
    linuxcnc.INTERP_PAUSED: "interrupted",
}


class Settings:
    """Section [TALC] of LinuxCNC's INI file. Ends with a message for an invalid value."""

    def __init__(self, path: Path) -> None:
        self._ini, self._path = linuxcnc.ini(str(path)), path
        self.bound_um, self.slew = self.number("BOUND", 0.2) * 1e3, self.number("SLEW", 0.01)
        self.pivot = [self.number(f"PIVOT_{axis}", 0.0) for axis in "XYZ"]
        self.probe_tool = round(self.number("PROBE_TOOL", 99))
        self.host, self.port = self.text("ADDRESS", "127.0.0.1"), round(self.number("PORT", 7621))
        self.key = path.parent / self.text("KEY", "talc.key")

    def text(self, name: str, default: str) -> str:
        return self._ini.find("TALC", name) or default

    def number(self, name: str, default: float) -> float:
        text = self.text(name, str(default))
        try:
            return float(text)
        except ValueError:
            raise SystemExit(f"{self._path}, [TALC] {name} = {text!r}: expected a number") from None


class Travel:
    """Mean speed of each axis since the last question: a momentary feed says little about heat."""

    def __init__(self) -> None:
        self._path, self._last, self._since_s = [0.0] * len(ALL_AXES), None, 0.0

    def add(self, now: float, positions: tuple[float, ...]) -> None:
        if self._last is None:
            self._since_s = now
        else:
            self._path = [p + abs(a - b) for p, a, b in zip(self._path, positions, self._last, strict=True)]
        self._last = positions

    def take(self, now: float) -> dict[str, float]:
        """mm/min and 1/min; nothing when no time has passed."""
        passed = now - self._since_s
        if self._last is None or passed <= 0:
            return {}
        per_min = [p / passed * 60.0 for p in self._path]
        self._path, self._since_s = [0.0] * len(ALL_AXES), now
        return {
            f"speed_{axis}": v / (360.0 if axis in "AC" else 1.0) for axis, v in zip(ALL_AXES, per_min, strict=True)
        }


class Control:
    """The commands: a fixed list, each with its arguments checked."""

    def __init__(self, settings: Settings, pins: Any) -> None:
        self._settings, self._pins = settings, pins
        self._owner, self._nc, self._command = 0, None, None
        self._seconds, self._moved_s = -1.0, 0.0
        self._cycle, self._travel = Cycle(pins, settings.probe_tool), Travel()
        self.verbs = {
            name: getattr(self, name)
            for name in ("status", "read", "write", "claim", "heartbeat", "release", "probe", "probing", "withdraw")
        }

    def step(self) -> None:
        now = time.monotonic()
        nc = self._poll()
        if nc is not None:
            self._travel.add(now, nc.joint_actual_position[: len(ALL_AXES)])
        self._cycle.step(now, nc, self._command)

    def status(self, _: dict[str, Any]) -> dict[str, Any]:
        """Positions: the tool's tip from where A and C meet, mm; A, C in degrees."""
        s = self._poll()
        if s is None:
            raise Refusal("LinuxCNC does not run, or its state stands still")
        joints = s.joint_actual_position[: len(ALL_AXES)]
        zero = [*(p + t for p, t in zip(self._settings.pivot, s.tool_offset[:3], strict=True)), 0.0, 0.0]
        return {
            "positions": {axis: j - z for axis, j, z in zip(ALL_AXES, joints, zero, strict=True)},
            "states": {
                "spindle_speed": abs(s.spindle[0]["speed"]) if s.spindle[0]["enabled"] else 0.0,
                "coolant": float(bool(s.flood or s.mist)),
                **self._travel.take(time.monotonic()),
            },
            "estop": bool(s.estop),
            "on": s.task_state == linuxcnc.STATE_ON,
            "homed": all(s.homed[: s.joints]),
            "mode": MODES.get(s.task_mode, "unknown"),
            "program": PROGRAM.get(s.interp_state, "unknown"),
            "cannot_probe": self._cycle.obstacle(s),
            "tool": s.tool_in_spindle,
            "probe": s.tool_in_spindle == self._settings.probe_tool,
            "probing": self._cycle.under_way,
        }

    def read(self, _: dict[str, Any] | None = None) -> list[float]:
        """The offsets in force, µm: after the bound and the slew of talc.hal."""
        return [self._pins[f"{axis}-in-force"] * 1e3 for axis in AXES]

    def write(self, command: dict[str, Any]) -> None:
        um = command.get("um")
        if not isinstance(um, list) or len(um) != len(AXES):
            raise Refusal("um: expected a list of three numbers")
        um = [number(v, "um") for v in um]
        if any(abs(v) > self._settings.bound_um for v in um):
            raise Refusal(f"um = {um}: beyond [TALC] BOUND, {self._settings.bound_um:g} µm")
        if not self._owner or command.get("owner") != self._owner or not self._pins["watching"]:
            raise Refusal("no heartbeat: claim the control and keep it alive before writing")
        self._want(um)

    def claim(self, command: dict[str, Any]) -> None:
        who = owner(command)
        silence, ramp = (number(command.get(name), name) for name in ("silence_s", "ramp_um_per_s"))
        earlier = whole(command, "predecessor") if "predecessor" in command else 0
        if self._owner not in (0, who, earlier) and self._pins["watching"]:
            raise Refusal(f"the control's compensation belongs to gateway {self._owner}, not to this one")
        if not (0.05 <= silence <= 86400.0 and 0.0 <= ramp <= 1000.0):
            raise Refusal("expected silence_s 0.05 to 86400 and ramp_um_per_s 0 to 1000")
        self._owner = who
        # On silence limit2 moves at talc.ramp in SLEW's place: nobody agrees on more than that.
        ramp = min(ramp * 1e-3, self._settings.slew)
        self._pins["silence"], self._pins["ramp"], self._pins["free"] = silence, ramp, False
        self._beat()

    def heartbeat(self, command: dict[str, Any]) -> bool:
        """Whether the watchdog was active until now."""
        if (who := owner(command)) != self._owner:
            raise Refusal(f"the control's compensation belongs to gateway {self._owner}, not to {who}")
        watched = bool(self._pins["watching"])
        self._beat()
        return watched

    def release(self, command: dict[str, Any]) -> None:
        if owner(command) == self._owner:
            self._owner, self._pins["free"] = 0, True

    def probe(self, command: dict[str, Any]) -> None:
        valid_for = number(command.get("valid_for_s"), "valid_for_s")
        self._cycle.request(time.monotonic(), whole(command, "number"), valid_for)

    def probing(self, command: dict[str, Any]) -> dict[str, Any]:
        return self._cycle.status(whole(command, "number"))

    def withdraw(self, command: dict[str, Any]) -> None:
        self._cycle.withdraw(whole(command, "number"))

    def _beat(self) -> None:
        if not self._pins["watching"]:
            self._want(self.read())  # a ramp has begun: it ends here, and does not go back to where it came from
        if self._pins["beat"] == self._pins["beat-seen"]:  # two turns between two looks of real time would be none
            self._pins["beat"] = not self._pins["beat"]

    def _want(self, um: list[float]) -> None:
        for axis, v in zip(AXES, um, strict=True):
            self._pins[axis] = v * 1e-3

    def _poll(self) -> Any:
        """LinuxCNC's state, or None before it runs, after it has ended, or while it stands still."""
        try:
            if self._nc is None:
                self._nc, self._command = linuxcnc.stat(), linuxcnc.command()
            self._nc.poll()
        except linuxcnc.error:
            self._nc = None
            return None
        if self._nc.ain[SECONDS] != self._seconds:
            self._seconds, self._moved_s = self._nc.ain[SECONDS], time.monotonic()
        return self._nc if time.monotonic() - self._moved_s < FROZEN_S else None


def number(value: object, name: str) -> float:
    try:
        if not isinstance(value, bool) and isinstance(value, (int, float)) and math.isfinite(value):
            return float(value)
    except OverflowError:  # JSON's integers may be longer than any float
        pass
    raise Refusal(f"{name} = {value!r}: expected a finite number")


def whole(command: dict[str, Any], name: str) -> int:
    value = command.get(name)
    if isinstance(value, bool) or not isinstance(value, int) or not 0 < value < 2**31:
        raise Refusal(f"{name} = {value!r}: expected 1 to 2147483647")
    return value


def owner(command: dict[str, Any]) -> int:
    return whole(command, "owner")


def component() -> Any:
    """The pins that talc_agent.hal connects."""
    it = hal.component("talc")
    for name in (*AXES, "silence", "ramp", "request", "withdrawn"):
        it.newpin(name, hal.HAL_FLOAT, hal.HAL_OUT)
    centres = (f"centre-{pose}-{axis}" for pose in range(POSES) for axis in AXES)
    for name in (*(f"{axis}-in-force" for axis in AXES), "answers", "state", "reason", "result-of", "spread", *centres):
        it.newpin(name, hal.HAL_FLOAT, hal.HAL_IN)
    for name in ("beat", "free"):
        it.newpin(name, hal.HAL_BIT, hal.HAL_OUT)
    for name in ("watching", "beat-seen", "may-start"):
        it.newpin(name, hal.HAL_BIT, hal.HAL_IN)
    it["free"] = True
    return it


def main() -> None:
    settings = Settings(Path(os.environ["INI_FILE_NAME"]))
    key = read_key(settings.key)
    # A listening socket may be handed over, as by systemd's socket activation.
    handed = os.environ.get("TALC_AGENT_FD")
    listener = socket.socket(fileno=int(handed)) if handed else socket.create_server((settings.host, settings.port))
    pins = component()
    control = Control(settings, pins)
    server = Server(listener, key, control.verbs)
    ended = False

    def end(*_: object) -> None:
        nonlocal ended
        ended = True

    signal.signal(signal.SIGTERM, end)
    signal.signal(signal.SIGINT, end)
    pins.ready()
    while not ended:
        server.turn()
        control.step()
    server.close()
    pins.exit()


main()
