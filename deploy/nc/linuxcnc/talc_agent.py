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
from talc_arguments import not_negative, whole
from talc_cycle import Cycle
from talc_joints import AXES as ALL_AXES
from talc_joints import MachineJoints, Unfit, machine_of
from talc_offsets import AXES, ERRORS, NO_LAPSE, Offsets
from talc_path import POSES, ProbingPath
from talc_server import Refusal, Server, read_key

VERSION, CAPABILITIES = 3, ("probe", "dry_run", "shift", "errors", "values")
MODES = {linuxcnc.MODE_MANUAL: "jog", linuxcnc.MODE_AUTO: "auto", linuxcnc.MODE_MDI: "mda"}
SECONDS, FROZEN_S = 42, 2.0
"""Analog input with the seconds of real time, see talc_agent.hal; unchanged for this long, it is stale."""
OUTPUTS = 4
"""Analog outputs, which a part program sets with M68, that are reported as states."""
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
        self.path = ProbingPath(machine)
        self.host, self.port = machine.text("ADDRESS", "127.0.0.1"), round(machine.number("PORT", 7621))
        self.key = folder / machine.text("KEY", "talc.key")

    @property
    def greeting(self) -> dict[str, Any]:
        """The machine, in the answer to a client that has logged in."""
        machine = self.machine
        return {
            "version": VERSION,
            "capabilities": CAPABILITIES,
            "poses": POSES if self.path.unfit else self.path.poses,
            "path": self.path.mark,
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
        self._nc, self._command = None, None
        self._seconds, self._moved_s = -1.0, 0.0
        self._cycle, self._travel = Cycle(pins, settings.path), Travel()
        self._offsets = Offsets(settings.machine, pins, hal.get_value)
        own = {name: getattr(self, name) for name in ("status", "probe", "probing", "withdraw", "values")}
        self.verbs = {**own, **self._offsets.verbs}

    def step(self) -> None:
        now = time.monotonic()
        nc = self._poll()
        if nc is not None:
            self._travel.add(now, self._settings.positions(nc))
            self._pins["seen"] = self._seconds
        self._cycle.step(now, nc, self._command)

    def status(self, _: dict[str, Any]) -> dict[str, Any]:
        """Positions: the tool's tip from where A and C meet, mm; A, C in degrees."""
        s = self._poll()
        if s is None:
            raise Refusal("LinuxCNC does not run, or its state does not change", "stale")
        obstacle = self._cycle.obstacle(s)
        return {
            "positions": self._settings.tip(s),
            "states": {
                "spindle_speed": abs(s.spindle[0]["speed"]) if s.spindle[0]["enabled"] else 0.0,
                "coolant": float(bool(s.flood or s.mist)),
                **{f"analog_output_{n}": float(s.aout[n]) for n in range(OUTPUTS)},
                **self._travel.take(time.monotonic()),
            },
            "estop": bool(s.estop),
            "on": s.task_state == linuxcnc.STATE_ON,
            "homed": all(s.homed[: s.joints]),
            "mode": MODES.get(s.task_mode, "unknown"),
            "program": PROGRAM.get(s.interp_state, "unknown"),
            "cannot_probe": obstacle,
            "cannot_probe_code": obstacle.code,
            "tool": s.tool_in_spindle,
            "probe": s.tool_in_spindle == self._settings.path.probe_tool,
            "probing": self._cycle.under_way,
        }

    def probe(self, command: dict[str, Any]) -> None:
        valid_for = not_negative(command, "valid_for_s")
        dry_run = not_negative(command, "dry_run_mm", 0.0)
        self._cycle.request(time.monotonic(), whole(command, "number"), valid_for, dry_run)
        self.step()  # when this is answered, the next safe point sees the request, unless it is refused already

    def probing(self, command: dict[str, Any]) -> dict[str, Any]:
        """As Cycle.status; when done, also the offsets that stood still, µm."""
        status = self._cycle.status(whole(command, "number"))
        return {**status, "in_force": self._offsets.offsets("held") if status["state"] == "done" else None}

    def withdraw(self, command: dict[str, Any]) -> None:
        self._cycle.withdraw(whole(command, "number"))

    def values(self, command: dict[str, Any]) -> dict[str, Any]:
        """Of HAL pins, signals and parameters: a number, None without one of this name, or a text that is no number.

        None of them has a time: they are as old as LinuxCNC's real-time seconds."""
        names = command.get("names")
        if not isinstance(names, list) or not names or not all(isinstance(name, str) and name for name in names):
            raise Refusal(f"names = {names!r}: expected a list of names of HAL pins, signals or parameters")
        stale = "" if self._poll() is not None else "LinuxCNC does not run, or its state does not change"
        return {"values": [hal_value(name) for name in names], "stale": stale}

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


def component() -> Any:
    """The pins that talc_agent.hal connects."""
    it = hal.component("talc")
    bounds = [f"{axis}-bound" for axis in AXES]
    for name in (*ERRORS, *bounds, "silence", "ramp", "request", "withdrawn", "dry-run", "seen"):
        it.newpin(name, hal.HAL_FLOAT, hal.HAL_OUT)
    centres = (f"centre-{pose}-{axis}" for pose in range(POSES) for axis in AXES)
    in_force = (f"{name}-in-force" for name in (*AXES, *ERRORS))
    held = (f"{axis}-held" for axis in AXES)
    for name in (*in_force, *held, "answers", "state", "reason", "result-of", "spread", *centres):
        it.newpin(name, hal.HAL_FLOAT, hal.HAL_IN)
    for name in ("beat", "free", "called"):
        it.newpin(name, hal.HAL_BIT, hal.HAL_OUT)
    for name in ("watching", "beat-seen", "may-start", "probe-error"):
        it.newpin(name, hal.HAL_BIT, hal.HAL_IN)
    it.newpin("lapse", hal.HAL_S32, hal.HAL_IN)
    it.newpin("of-lapse", hal.HAL_S32, hal.HAL_OUT)
    it["free"], it["of-lapse"] = True, NO_LAPSE
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
