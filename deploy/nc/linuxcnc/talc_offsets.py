"""Who owns the compensation, and what the component talc-errors is to put in force: its pins, in HAL."""

import math
import time
from collections.abc import Callable
from typing import Any, Protocol

from talc_arguments import number, numbers, positive, whole
from talc_joints import MachineJoints
from talc_server import Refusal

AXES = "xyz"
ERRORS = ("ey0a", "ez0a", "ex0c", "ey0c", "ez0t", "er0t", "ea0c", "eb0c", "ec0c")
"""The gateway's nine errors, in its order."""
NO_LAPSE = -1
"""Of the pin of-lapse: what the pins say was written for no claim."""


class Pins(Protocol):
    """The HAL component's pins by name."""

    def __getitem__(self, name: str) -> Any: ...

    def __setitem__(self, name: str, value: Any) -> None: ...


class Offsets:
    """The commands of claim, heartbeat and offsets.

    The component counts the lapses of its watchdog. What is written is meant for the claim that lives then, and says so
    by this count: after silence or a release the component holds what is in force until something is written for the
    next claim, however late this program runs.

    pin_value: the value of one of LinuxCNC's pins.
    """

    def __init__(self, machine: MachineJoints, pins: Pins, pin_value: Callable[[str], float]) -> None:
        self._machine, self._pins, self._pin_value = machine, pins, pin_value
        self._um = machine.mm * 1e3
        """µm in one of LinuxCNC's linear units, in which the pins are."""
        self._owner, self._turned_s = 0, -math.inf
        names = "read", "write", "errors", "write_errors", "claim", "heartbeat", "release"
        self.verbs: dict[str, Callable[[dict[str, Any]], Any]] = {name: getattr(self, name) for name in names}

    def read(self, _: dict[str, Any] | None = None) -> list[float]:
        """The offsets in force, µm: after the bound and the slew of talc_errors.comp, where the tool is."""
        return self.offsets("in-force")

    def offsets(self, which: str) -> list[float]:
        """in-force, or held in the last cycle; µm."""
        return [self._pins[f"{axis}-{which}"] * self._um for axis in AXES]

    def write(self, command: dict[str, Any]) -> None:
        """A shift, the same wherever the tool is: three of the nine errors are one."""
        x, y, z = numbers(command, "um", len(AXES))
        most = self._machine.bound_um
        if max(abs(x), abs(y), abs(z)) > most:
            raise Refusal(f"um = {[x, y, z]}: beyond [TALC] BOUND, {most:g} µm", "bound")
        self._want(command, [y, z, x, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], [most] * 3)

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
        self._want(command, wanted, bound)

    def _share(self, name: str, radius_mm: float) -> float:
        """The share of the component's error at this radius: ER0T grows with the radius."""
        return radius_mm / self._machine.radius if name == "er0t" else 1.0

    def claim(self, command: dict[str, Any]) -> None:
        who = whole(command, "owner")
        silence, ramp = (number(command.get(name), name) for name in ("silence_s", "ramp_um_per_s"))
        earlier = whole(command, "predecessor") if "predecessor" in command else 0
        watched = self._watched()
        if self._owner not in (0, who, earlier) and watched:
            raise Refusal(f"the control's compensation belongs to gateway {self._owner}, not to this one", "owner")
        if not (0.05 <= silence <= 86400.0 and ramp >= 0.0):
            raise Refusal("expected silence_s 0.05 to 86400 and ramp_um_per_s 0 or more")
        if why := self._machine.elsewhere(self._pin_value):
            raise Refusal(why, "other_axes")
        goes_on = watched and self._owner in (who, earlier) and self._owner != 0
        self._owner = who
        if not goes_on:
            self._pins["of-lapse"] = NO_LAPSE  # first: what an earlier claim wanted is gone
        self._pins["silence"], self._pins["ramp"], self._pins["free"] = silence, ramp, False
        self._beat()

    def heartbeat(self, command: dict[str, Any]) -> bool:
        """Whether the watchdog was active until now."""
        if (who := whole(command, "owner")) != self._owner:
            raise Refusal(f"the control's compensation belongs to gateway {self._owner}, not to {who}", "owner")
        watched = self._watched()
        self._beat()
        return watched

    def release(self, command: dict[str, Any]) -> None:
        if whole(command, "owner") == self._owner:
            self._owner, self._pins["free"] = 0, True

    def _watched(self) -> bool:
        """Whether the watchdog is active; also from a beat until the component has seen it, which takes a while on a
        busy computer. A component that has not seen it for the whole silence does not run: its pins are old."""
        if self._pins["beat"] == self._pins["beat-seen"]:
            return bool(self._pins["watching"])
        return bool(time.monotonic() - self._turned_s < self._pins["silence"])

    def _beat(self) -> None:
        if self._pins["beat"] == self._pins["beat-seen"]:  # two turns between two looks of real time would be none
            self._pins["beat"], self._turned_s = not self._pins["beat"], time.monotonic()

    def _want(self, command: dict[str, Any], errors: list[float], bound_um: list[float]) -> None:
        lapse = self._pins["lapse"]
        if not self._owner or command.get("owner") != self._owner or not self._watched():
            raise Refusal("no heartbeat: claim the control and keep it alive before writing", "no_heartbeat")
        for name, v in zip(ERRORS, errors, strict=True):
            self._pins[name] = v
        for axis, v in zip(AXES, bound_um, strict=True):
            self._pins[f"{axis}-bound"] = v
        self._pins["of-lapse"] = lapse
