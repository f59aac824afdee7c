"""Handles one probing request at a time: waits for the part program's safe point, or starts the cycle where allowed.

Times are arguments. The pins are the handshake with talc_safe_point.ngc, see talc_agent.hal.
"""

import math
from typing import Any

import hal
import linuxcnc
import talc_reasons as why
from talc_offsets import Pins
from talc_path import POSES, ProbingPath
from talc_reasons import Reason
from talc_server import Refusal

STATES = {1: "accepted", 2: "running", 3: "done", 4: "refused", 5: "failed"}
FINAL = ("done", "refused", "failed")
G59_3 = 9
"""The coordinate system of the cycle."""
START_LIMIT_S, IDLE_LIMIT_S, STATUS_LIMIT_S = 10.0, 0.5, 2.0
HIGHEST_MM = 1000.0
"""Of a dry run, as the protocol has it."""


class Cycle:
    """The gateway's request and its progress."""

    def __init__(self, pins: Pins, path: ProbingPath) -> None:
        self._pins, self._path = pins, path
        self._number, self._state, self._reason, self._void = 0, "idle", why.NONE, why.NONE
        self._dry_run_mm = 0.0
        self._expires_s = math.inf
        self._since_idle_s: float | None = None
        self._mode_before: int | None = None
        self._halted = False
        """Whether a cycle was stopped, and nobody has said since, by talc.may-start, that the machine may move."""
        self._started_s: float | None = None
        self._taken_s: float | None = None
        """When LinuxCNC's status was first seen after the program had taken the request."""
        self._begun, self._rests, self._ended, self._leaving = False, True, True, False
        """_leaving: the program of the request before, which was withdrawn when it had just been taken, still runs."""
        self._began_in: tuple[int, str] | None = None
        """Mode, and in MDI the block, in which the control has taken the request."""

    @property
    def under_way(self) -> bool:
        return self._state in ("accepted", "running")

    def request(self, now: float, number: int, valid_for_s: float, dry_run_mm: float) -> None:
        """Ask. Refused while another request waits or runs. dry_run_mm: 0, or the height of a dry run."""
        least_mm = self._path.least_dry_run_mm()
        if dry_run_mm and not least_mm <= dry_run_mm <= HIGHEST_MM:
            raise Refusal(f"dry_run_mm = {dry_run_mm:g}: expected 0, or {least_mm:g} to {HIGHEST_MM:g} over the sphere")
        if number == self._number:
            text = f"request number {number} was the last one: its old result could be taken for a new one"
            raise Refusal(text, "number_again")
        if self.under_way:
            raise Refusal(f"cycle {self._number} is under way", "under_way")
        if self._state == "requested":
            raise Refusal(f"request {self._number} waits for the control's next safe point", "waits")
        self._leaving = 0 != self._number == self._pins["answers"] and not self._ended
        self._number, self._state, self._reason, self._void = number, "requested", why.NONE, why.NONE
        self._expires_s = now + valid_for_s if valid_for_s > 0 else math.inf
        self._started_s, self._since_idle_s, self._began_in, self._taken_s = None, None, None, None
        self._begun = self._ended = False
        self._dry_run_mm = dry_run_mm

    def withdraw(self, number: int) -> None:
        """Withdraw a waiting request; a running cycle checks this before each pose and touch."""
        if number == self._number and self._state not in ("idle", *FINAL):
            if self._state == "requested":
                self._refuse(why.WITHDRAWN)
            else:
                self._pins["withdrawn"] = float(number)

    def status(self, number: int) -> dict[str, Any]:
        """State, reason; when done, mm: centres in the order of the poses, spread of repeated touches."""
        if number != self._number:
            return {"state": "idle", "reason": "", "code": "", "centres": None, "spread": None}
        centres = spread = None
        if self._state == "done":
            centres = [[self._pins[f"centre-{pose}-{axis}"] for axis in "xyz"] for pose in range(POSES)]
            spread = self._pins["spread"]
        return {
            **{"state": self._state, "reason": self._reason, "code": self._reason.code},
            **{"centres": centres, "spread": spread},
        }

    def obstacle(self, nc: Any) -> Reason:
        """Why a cycle cannot begin in the present state; empty: it can, in a part program at its next safe point."""
        if impossible := self._impossible(nc, 0.0):
            return impossible
        if nc.interp_state != linuxcnc.INTERP_IDLE:
            return why.NONE
        if not self._pins["may-start"]:
            return why.NOT_ALLOWED
        if _moves(nc):
            return why.BY_HAND
        # Somebody or something has stopped a cycle: whoever takes the probe up, and allows it again, has looked.
        if self._path.is_low(nc):
            return why.PROBE_IS_LOW
        return why.HALTED if self._halted else why.NONE

    def _impossible(self, nc: Any, dry_run_mm: float) -> Reason:
        if not _is_ready(nc):
            return why.OFF
        return why.EXTERNAL if hal.get_value("motion.eoffset-active") else self._path.obstacle(nc, dry_run_mm)

    def step(self, now: float, nc: Any, command: Any) -> None:
        """Check program and control. nc: a fresh linuxcnc.stat, or None when LinuxCNC does not answer."""
        self._rests = nc is not None and _idle(nc)
        self._halted = self._halted and self._pins["may-start"]
        if nc is not None and self._pins["called"]:
            self._guard(nc, command)
        if self._number and self._pins["answers"] == self._number and self._state not in ("idle", *FINAL):
            self._follow(now, nc, command)
        elif self._state == "requested":
            self._wait(now, nc, command)
        # A request may have been refused here at the moment at which the program has taken it.
        self._ended = self._ended or (self._state in FINAL and (self._rests or self._told() in FINAL))
        if nc is not None and self._mode_before is not None and self._state in FINAL and self._rests:
            if nc.task_mode == linuxcnc.MODE_MDI:  # otherwise somebody has chosen another one
                command.mode(self._mode_before)
            self._mode_before = None

    def _guard(self, nc: Any, command: Any) -> None:
        """Stop the program that the agent has called, to its last tool change, when it may not run any more."""
        if nc.task_mode != linuxcnc.MODE_MDI or (self._rests and (self._state in FINAL or not self._begun)):
            self._pins["called"] = False
        elif not self._pins["may-start"]:
            if self._begun:  # otherwise a new request waits for the end of the program before
                self._void = self._void or why.NOT_ALLOWED_ANY_MORE
            self._pins["called"] = False
            command.abort()

    def _follow(self, now: float, nc: Any, command: Any) -> None:
        """The program has taken the request: its state counts, unless it was stopped or was not alone."""
        if nc is not None and self._taken_s is None:
            self._taken_s = now
        if nc is not None and not self._is_from_before(now, nc):
            self._watch(nc, command)
        told = self._told()
        if told == "done" and self._pins["result-of"] != self._number:
            told = "running"  # its pins are not all written yet
        if told in FINAL:
            void = why.NONE if told == "refused" else self._void
            self._end("failed" if void else told, void or why.of_program(round(self._pins["reason"])))
            return
        self._state = told
        if nc is None or not self._rests:
            self._since_idle_s = None
        elif self._since_idle_s is None:
            self._since_idle_s = now
        elif now - self._since_idle_s > IDLE_LIMIT_S:
            self._stopped(nc, command)

    def _stopped(self, nc: Any, command: Any) -> None:
        """The program has ended without a result. Where the machine may move by itself, the agent's own goes up first
        when LinuxCNC's interpreter has ended it: then talc_abort has not yet taken back what is the cycle's."""
        stopped = why.INTERPRETER if nc.g5x_index == G59_3 else why.STOPPED
        may = self._pins["called"] and nc.task_mode == linuxcnc.MODE_MDI and _is_ready(nc)  # allowed still: see _guard
        if stopped is why.INTERPRETER and may and not self._void:
            self._void, self._since_idle_s = stopped, None
            command.mdi("o<talc_recover> call")
        else:
            self._end("failed", self._void or stopped)
            command.abort()  # which calls talc_abort

    def _told(self) -> str:
        return STATES.get(round(self._pins["state"]), "accepted")

    def _is_from_before(self, now: float, nc: Any) -> bool:
        """Whether LinuxCNC's status may be older than the pins, which show already that the program has begun."""
        if self._began_in is not None or self._taken_s is None or now - self._taken_s > STATUS_LIMIT_S:
            return False
        called = nc.task_mode != linuxcnc.MODE_MDI or (nc.command and not nc.queued_mdi_commands)
        return self._rests or not called

    def _watch(self, nc: Any, command: Any) -> None:
        """Void the result if LinuxCNC does something that the cycle has not commanded.

        The program sees position and modes itself, see talc_check.ngc. It then goes up, as it does when told so here.
        """
        now_in = nc.task_mode, nc.command if nc.task_mode == linuxcnc.MODE_MDI else ""
        if self._began_in is None:
            self._began_in = now_in
        elif not self._began_in[1]:
            self._began_in = self._began_in[0], now_in[1]  # shown late
        if self._void:
            return
        mode, block = self._began_in
        if not _is_ready(nc):
            self._void = why.OFF  # LinuxCNC has stopped the program
        elif nc.task_mode != mode:
            self._void = why.OTHER_MODE
            command.abort()  # in MANUAL the program would neither go on nor end
        elif nc.queued_mdi_commands or now_in[1] not in ("", block) or _by_hand(nc):
            self._void = why.FOREIGN
            self._pins["withdrawn"] = -float(self._number)

    def _wait(self, now: float, nc: Any, command: Any) -> None:
        if nc is None:
            return
        self._leaving = self._leaving and not self._rests and self._told() not in FINAL
        if impossible := self._impossible(nc, self._dry_run_mm):
            self._refuse(impossible)
            return
        if not self._leaving and self._pins["request"] != self._number:
            self._pins["withdrawn"], self._pins["dry-run"] = 0.0, self._dry_run_mm
            self._pins["request"] = float(self._number)
        obstacle = self.obstacle(nc)
        if now >= self._expires_s:
            self._refuse(why.EXPIRED)
        elif self._started_s is not None:
            self._start(now, nc, command, obstacle)
        elif _idle(nc) and not obstacle and not self._leaving:
            self._started_s = now
            if self._mode_before is None:  # otherwise the cycle before has not given it back yet
                self._mode_before = nc.task_mode
            command.mode(linuxcnc.MODE_MDI)

    def _start(self, now: float, nc: Any, command: Any, obstacle: Reason) -> None:
        if self._started_s is not None and now - self._started_s > START_LIMIT_S:
            self._refuse(why.NOT_STARTED)
        elif not self._begun and nc.task_mode == linuxcnc.MODE_MDI and _idle(nc) and not obstacle:
            self._begun = self._pins["called"] = True
            command.mdi("o<talc_safe_point> call")

    def _refuse(self, reason: Reason) -> None:
        if not self._leaving:
            self._pins["withdrawn"] = float(self._number)  # should the program be taking it at this moment
        self._end("refused", reason)

    def _end(self, state: str, reason: Reason) -> None:
        self._state, self._reason = state, reason
        self._halted = self._halted or reason in (why.STOPPED, why.OTHER_MODE, why.NOT_STARTED)
        self._halted = self._halted or (state == "failed" and reason == why.OFF)
        self._pins["request"] = 0.0


def _is_ready(nc: Any) -> bool:
    return nc.task_state == linuxcnc.STATE_ON and all(nc.homed[: nc.joints])


def _idle(nc: Any) -> bool:
    return nc.interp_state == linuxcnc.INTERP_IDLE and nc.state != linuxcnc.RCS_EXEC and not nc.queued_mdi_commands


def _by_hand(nc: Any) -> bool:
    """Whether the machine is moved, or may be, in another way than by the program: also within one of its moves."""
    jogged = nc.motion_mode != linuxcnc.TRAJ_MODE_COORD
    return jogged or any(hal.get_value(f"motion.{pin}") for pin in ("switchkins-type", "eoffset-active"))


def _moves(nc: Any) -> bool:
    """Without a program: jogging or a handwheel, and a spindle that turns may be in a cut."""
    return any(joint["velocity"] for joint in nc.joint[: nc.joints]) or any(
        spindle["enabled"] for spindle in nc.spindle[: nc.spindles]
    )
