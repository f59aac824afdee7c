"""Handles one probing request at a time: waits for the part program's safe point, or starts the cycle where allowed.

Times are arguments. The pins are the handshake with talc_safe_point.ngc, see talc_agent.hal.
"""

import math
from typing import Any, Protocol

import linuxcnc
from talc_server import Refusal

STATES = {1: "accepted", 2: "running", 3: "done", 4: "refused", 5: "failed"}
FINAL = ("done", "refused", "failed")
REASONS = {
    0: "",
    2: "the touch probe is missing or its contact is closed",
    3: "the kinematics are not the identity",
    4: "withdrawn",
    6: "a touch found no sphere",
}
OFF, NO_PROBE = "the machine is off or not homed", "the touch probe is not in the tool table"
POSES = 6
START_LIMIT_S, IDLE_LIMIT_S = 10.0, 0.5


class Pins(Protocol):
    """The HAL component's pins by name."""

    def __getitem__(self, name: str) -> Any: ...

    def __setitem__(self, name: str, value: Any) -> None: ...


class Cycle:
    """The gateway's request and its progress.

    unfit: why the probing program cannot run on this machine at all; empty: it can.
    """

    def __init__(self, pins: Pins, probe_tool: int, unfit: str) -> None:
        self._pins, self._probe_tool, self._unfit = pins, probe_tool, unfit
        self._number, self._state, self._reason = 0, "idle", ""
        self._expires_s = math.inf
        self._since_idle_s: float | None = None
        self._mode_before: int | None = None
        self._started_s: float | None = None
        self._begun = False

    @property
    def under_way(self) -> bool:
        return self._state in ("accepted", "running")

    def request(self, now: float, number: int, valid_for_s: float) -> None:
        """Ask. Refused while another request waits or runs."""
        if number == self._number:
            raise Refusal(f"request number {number} was the last one: its old result could be taken for a new one")
        if self.under_way:
            raise Refusal(f"cycle {self._number} is under way")
        if self._state == "requested":
            raise Refusal(f"request {self._number} waits for the control's next safe point")
        self._number, self._state, self._reason = number, "requested", ""
        self._expires_s = now + valid_for_s if valid_for_s > 0 else math.inf
        self._started_s, self._since_idle_s, self._begun = None, None, False
        self._pins["withdrawn"] = 0.0
        self._pins["request"] = float(number)

    def withdraw(self, number: int) -> None:
        """Withdraw a waiting request; a running cycle checks this before each pose and touch."""
        if number == self._number and self._state not in ("idle", *FINAL):
            self._pins["withdrawn"] = float(number)
            if self._state == "requested":
                self._refuse("withdrawn")

    def status(self, number: int) -> dict[str, Any]:
        """State, reason; when done, mm: centres in the order of the poses, spread of repeated touches."""
        if number != self._number:
            return {"state": "idle", "reason": "", "centres": None, "spread": None}
        centres = spread = None
        if self._state == "done":
            centres = [[self._pins[f"centre-{pose}-{axis}"] for axis in "xyz"] for pose in range(POSES)]
            spread = self._pins["spread"]
        return {"state": self._state, "reason": self._reason, "centres": centres, "spread": spread}

    def obstacle(self, nc: Any) -> str:
        """Why a cycle cannot begin in the present state; empty: it can, in a part program at its next safe point."""
        if nc.task_state != linuxcnc.STATE_ON or not all(nc.homed[: nc.joints]):
            return OFF
        if self._unfit:
            return self._unfit
        if all(tool.id != self._probe_tool for tool in nc.tool_table):
            return NO_PROBE  # LinuxCNC would end the part program that wants to change it in
        if nc.interp_state != linuxcnc.INTERP_IDLE:
            return ""
        if not self._pins["may-start"]:
            return "no program runs, and the pin talc.may-start is FALSE"
        return "the machine is being moved by hand" if _moves(nc) else ""

    def step(self, now: float, nc: Any, command: Any) -> None:
        """Check program and control. nc: a fresh linuxcnc.stat, or None when LinuxCNC does not answer."""
        if self._number and self._pins["answers"] == self._number and self._state != "idle":
            self._follow(now, nc)
        elif self._state == "requested":
            self._wait(now, nc, command)
        if nc is not None and self._mode_before is not None and self._state in FINAL and _idle(nc):
            command.mode(self._mode_before)
            self._mode_before = None

    def _follow(self, now: float, nc: Any) -> None:
        """The program has taken the request: its state counts, unless it was stopped."""
        told = STATES.get(round(self._pins["state"]), "accepted")
        if told == "done" and self._pins["result-of"] != self._number:
            told = "running"  # its pins are not all written yet
        if told in FINAL:
            self._end(told, REASONS.get(round(self._pins["reason"]), f"reason {self._pins['reason']:g}"))
            return
        if self._state in FINAL:
            return
        self._state = told
        if nc is None or not _idle(nc):
            self._since_idle_s = None
        elif self._since_idle_s is None:
            self._since_idle_s = now
        elif now - self._since_idle_s > IDLE_LIMIT_S:
            self._end("failed", "the program was stopped")

    def _wait(self, now: float, nc: Any, command: Any) -> None:
        if nc is None:
            return
        obstacle = self.obstacle(nc)
        if obstacle in (OFF, NO_PROBE, self._unfit) and obstacle:
            self._refuse(obstacle)
        elif now >= self._expires_s:
            self._refuse("no safe point before the request expired")
        elif self._started_s is not None:
            self._start(now, nc, command, obstacle)
        elif _idle(nc) and not obstacle:
            self._started_s = now
            if self._mode_before is None:  # otherwise the cycle before has not given it back yet
                self._mode_before = nc.task_mode
            command.mode(linuxcnc.MODE_MDI)

    def _start(self, now: float, nc: Any, command: Any, obstacle: str) -> None:
        if self._started_s is not None and now - self._started_s > START_LIMIT_S:
            self._refuse("the program did not start")
        elif not self._begun and nc.task_mode == linuxcnc.MODE_MDI and _idle(nc) and not obstacle:
            command.mdi("o<talc_safe_point> call")
            self._begun = True

    def _refuse(self, reason: str) -> None:
        self._pins["withdrawn"] = float(self._number)  # should the program be taking it at this moment
        self._end("refused", reason)

    def _end(self, state: str, reason: str) -> None:
        self._state, self._reason = state, reason
        self._pins["request"] = 0.0


def _idle(nc: Any) -> bool:
    return nc.interp_state == linuxcnc.INTERP_IDLE and nc.state != linuxcnc.RCS_EXEC


def _moves(nc: Any) -> bool:
    """Without a program: jogging or a handwheel, and a spindle that turns may be in a cut."""
    return any(joint["velocity"] for joint in nc.joint[: nc.joints]) or any(
        spindle["enabled"] for spindle in nc.spindle[: nc.spindles]
    )
