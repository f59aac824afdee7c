#!/usr/bin/python3
"""The gateway's agent on LinuxCNC: reports the control's state, requests probing cycles, passes offsets to HAL.

A HAL component named talc, started by talc_agent.hal under the system's Python. The watchdog over the gateway's
heartbeat is not here but in real time, in talc_errors.comp: a killed agent sends no more beats.
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
from talc_joints import AXES as ALL_AXES
from talc_joints import MachineJoints, Unfit, machine_of
from talc_server import Refusal, Server, read_key

AXES = "xyz"
ERRORS = ("ey0a", "ez0a", "ex0c", "ey0c", "ez0t", "er0t", "ea0c", "eb0c", "ec0c")
"""The gateway's nine errors, in its order."""
COUNTS = {3: "three", 9: "nine"}
VERSION, CAPABILITIES = 3, ("probe", "shift", "errors", "values")
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
    """LinuxCNC's INI file: its machine, and what the section [TALC] says of the agent. Raises Unfit."""

    def __init__(self, machine: MachineJoints, folder: Path) -> None:
        self.machine = machine
        self.probe_tool = round(machine.number("PROBE_TOOL", 99))
        self.host, self.port = machine.text("ADDRESS", "127.0.0.1"), round(machine.number("PORT", 7621))
        self.key = folder / machine.text("KEY", "talc.key")

    @property
    def greeting(self) -> dict[str, Any]:
        """The machine, in the answer to a client that has logged in."""
        machine = self.machine
        return {
            "version": VERSION,
            "capabilities": CAPABILITIES,
            "poses": POSES,
            "units": machine.unit,
            "joints": machine.joints,
            "bound_um": machine.bound_um,
            "reach_mm": machine.reach,
        }

    def positions(self, nc: Any) -> tuple[float, ...]:
        """Positions of ALL_AXES in the machine's coordinates: mm and degrees. A gantry is where its first joint is."""
        at = [nc.joint_actual_position[self.machine.joints[axis][0]] for axis in ALL_AXES]
        return tuple(v if axis in "AC" else v * self.machine.mm for axis, v in zip(ALL_AXES, at, strict=True))

    def tip(self, nc: Any) -> dict[str, float]:
        """The tool's tip from where A and C meet, mm; A, C in degrees."""
        tool = [v * self.machine.mm for v in nc.tool_offset[:3]]
        zero = [*(p + t for p, t in zip(self.machine.pivot, tool, strict=True)), 0.0, 0.0]
        return {axis: p - z for axis, p, z in zip(ALL_AXES, self.positions(nc), zero, strict=True)}


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
        self._um = settings.machine.mm * 1e3
        """µm in one of LinuxCNC's linear units, in which the pins are."""
        self._owner, self._nc, self._command = 0, None, None
        self._seconds, self._moved_s = -1.0, 0.0
        self._cycle, self._travel = Cycle(pins, settings.probe_tool, settings.machine.cannot_probe), Travel()
        self.verbs = {
            name: getattr(self, name)
            for name in (
                *("status", "read", "write", "errors", "write_errors", "claim", "heartbeat", "release"),
                *("probe", "probing", "withdraw", "values"),
            )
        }

    def step(self) -> None:
        now = time.monotonic()
        nc = self._poll()
        if nc is not None:
            self._travel.add(now, self._settings.positions(nc))
        self._cycle.step(now, nc, self._command)

    def status(self, _: dict[str, Any]) -> dict[str, Any]:
        """Positions: the tool's tip from where A and C meet, mm; A, C in degrees."""
        s = self._poll()
        if s is None:
            raise Refusal("LinuxCNC does not run, or its state stands still")
        return {
            "positions": self._settings.tip(s),
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
        """The offsets in force, µm: after the bound and the slew of talc_errors.comp, where the tool is."""
        return self._offsets("in-force")

    def _offsets(self, which: str) -> list[float]:
        return [self._pins[f"{axis}-{which}"] * self._um for axis in AXES]

    def write(self, command: dict[str, Any]) -> None:
        """A shift, the same wherever the tool is: three of the nine errors are one."""
        x, y, z = numbers(command, "um", len(AXES))
        most = self._settings.machine.bound_um
        if max(abs(x), abs(y), abs(z)) > most:
            raise Refusal(f"um = {[x, y, z]}: beyond [TALC] BOUND, {most:g} µm")
        self._check_watched(command)
        self._want([y, z, x, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], [most] * 3)

    def errors(self, command: dict[str, Any]) -> list[float]:
        """The nine errors in force, µm and µm/m, after the slew; ER0T at `radius_mm`."""
        radius = positive(command, "radius_mm")
        return [self._pins[f"{name}-in-force"] * self._share(name, radius) for name in ERRORS]

    def write_errors(self, command: dict[str, Any]) -> None:
        """The nine errors, from which the component works out the offsets where the tool is."""
        radius, bound = positive(command, "radius_mm"), numbers(command, "bound_um", len(AXES))
        wanted = [v / self._share(name, radius) for name, v in zip(ERRORS, numbers(command, "errors", 9), strict=True)]
        if min(bound) < 0:
            raise Refusal(f"bound_um = {bound}: expected 0 or more")
        self._check_watched(command)
        self._want(wanted, bound)

    def _share(self, name: str, radius_mm: float) -> float:
        """The share of the component's error at this radius: ER0T grows with the radius."""
        return radius_mm / self._settings.machine.radius if name == "er0t" else 1.0

    def _check_watched(self, command: dict[str, Any]) -> None:
        if not self._owner or command.get("owner") != self._owner or not self._watched():
            raise Refusal("no heartbeat: claim the control and keep it alive before writing")

    def claim(self, command: dict[str, Any]) -> None:
        who = owner(command)
        silence, ramp = (number(command.get(name), name) for name in ("silence_s", "ramp_um_per_s"))
        earlier = whole(command, "predecessor") if "predecessor" in command else 0
        watched = self._watched()
        if self._owner not in (0, who, earlier) and watched:
            raise Refusal(f"the control's compensation belongs to gateway {self._owner}, not to this one")
        if not (0.05 <= silence <= 86400.0 and ramp >= 0.0):
            raise Refusal("expected silence_s 0.05 to 86400 and ramp_um_per_s 0 or more")
        if why := self._settings.machine.elsewhere(hal.get_value):
            raise Refusal(why)
        goes_on = watched and self._owner in (who, earlier) and self._owner != 0
        self._owner = who
        self._pins["silence"], self._pins["ramp"], self._pins["free"] = silence, ramp, False
        self._beat(goes_on)

    def heartbeat(self, command: dict[str, Any]) -> bool:
        """Whether the watchdog was active until now."""
        if (who := owner(command)) != self._owner:
            raise Refusal(f"the control's compensation belongs to gateway {self._owner}, not to {who}")
        watched = self._watched()
        self._beat(watched)
        return watched

    def release(self, command: dict[str, Any]) -> None:
        if owner(command) == self._owner:
            self._owner, self._pins["free"] = 0, True

    def probe(self, command: dict[str, Any]) -> None:
        valid_for = number(command.get("valid_for_s"), "valid_for_s")
        if valid_for < 0:
            raise Refusal(f"valid_for_s = {valid_for:g}: expected 0 or more")
        self._cycle.request(time.monotonic(), whole(command, "number"), valid_for)

    def probing(self, command: dict[str, Any]) -> dict[str, Any]:
        """As Cycle.status; when done, also the offsets that stood still, µm."""
        status = self._cycle.status(whole(command, "number"))
        return {**status, "in_force": self._offsets("held") if status["state"] == "done" else None}

    def withdraw(self, command: dict[str, Any]) -> None:
        self._cycle.withdraw(whole(command, "number"))

    def values(self, command: dict[str, Any]) -> dict[str, Any]:
        """Of HAL pins, signals and parameters: a number, None without one of this name, or a text that is no number.

        None of them has a time: they are as old as LinuxCNC's real-time seconds."""
        names = command.get("names")
        if not isinstance(names, list) or not names or not all(isinstance(name, str) and name for name in names):
            raise Refusal(f"names = {names!r}: expected a list of names of HAL pins, signals or parameters")
        stale = "" if self._poll() is not None else "LinuxCNC does not run, or its state stands still"
        return {"values": [hal_value(name) for name in names], "stale": stale}

    def _watched(self) -> bool:
        """Whether the watchdog is active; also from a beat until the component has seen it, which takes a while on a
        busy computer."""
        return bool(self._pins["watching"]) or self._pins["beat"] != self._pins["beat-seen"]

    def _beat(self, goes_on: bool) -> None:
        if not goes_on:
            self._want(
                [self._pins[f"{name}-in-force"] for name in ERRORS]
            )  # a ramp has begun: it ends here, and does not go back to where it came from
        if self._pins["beat"] == self._pins["beat-seen"]:  # two turns between two looks of real time would be none
            self._pins["beat"] = not self._pins["beat"]

    def _want(self, errors: list[float], bound_um: list[float] | None = None) -> None:
        for name, v in zip(ERRORS, errors, strict=True):
            self._pins[name] = v
        for axis, v in zip(AXES, bound_um or (), strict=bool(bound_um)):
            self._pins[f"{axis}-bound"] = v

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


def hal_value(name: str) -> float | str | None:
    try:
        value = hal.get_value(name)
    except (RuntimeError, ValueError):
        return None
    if not isinstance(value, (bool, int, float)):
        return f"a {type(value).__name__}"
    return float(value) if math.isfinite(value) else str(value)


def number(value: object, name: str) -> float:
    try:
        if not isinstance(value, bool) and isinstance(value, (int, float)) and math.isfinite(value):
            return float(value)
    except OverflowError:  # JSON's integers may be longer than any float
        pass
    raise Refusal(f"{name} = {value!r}: expected a finite number")


def numbers(command: dict[str, Any], name: str, count: int) -> list[float]:
    values = command.get(name)
    if not isinstance(values, list) or len(values) != count:
        raise Refusal(f"{name}: expected a list of {COUNTS[count]} numbers")
    return [number(v, name) for v in values]


def positive(command: dict[str, Any], name: str) -> float:
    value = number(command.get(name), name)
    if not value > 0:
        raise Refusal(f"{name} = {value:g}: expected more than 0")
    return value


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
    bounds = [f"{axis}-bound" for axis in AXES]
    for name in (*ERRORS, *bounds, "silence", "ramp", "request", "withdrawn"):
        it.newpin(name, hal.HAL_FLOAT, hal.HAL_OUT)
    centres = (f"centre-{pose}-{axis}" for pose in range(POSES) for axis in AXES)
    in_force = (f"{name}-in-force" for name in (*AXES, *ERRORS))
    held = (f"{axis}-held" for axis in AXES)
    for name in (*in_force, *held, "answers", "state", "reason", "result-of", "spread", *centres):
        it.newpin(name, hal.HAL_FLOAT, hal.HAL_IN)
    for name in ("beat", "free"):
        it.newpin(name, hal.HAL_BIT, hal.HAL_OUT)
    for name in ("watching", "beat-seen", "may-start"):
        it.newpin(name, hal.HAL_BIT, hal.HAL_IN)
    it["free"] = True
    for name in bounds:
        it[name] = math.inf
    return it


def main() -> None:
    ini = Path(os.environ["INI_FILE_NAME"])
    try:
        settings = Settings(machine_of(str(ini)), ini.parent)
    except Unfit as unfit:
        raise SystemExit(f"talc: {unfit}") from None
    key = read_key(settings.key)
    # A listening socket may be handed over, as by systemd's socket activation.
    handed = os.environ.get("TALC_AGENT_FD")
    listener = socket.socket(fileno=int(handed)) if handed else socket.create_server((settings.host, settings.port))
    pins = component()
    control = Control(settings, pins)
    server = Server(listener, key, control.verbs, settings.greeting, reading=("values",))
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
