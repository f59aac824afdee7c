"""The master spindle and the cutting fluid: what the part program has programmed, and what the main run does.

Function Manual, Basic Functions, 01/2015 (6FC5397-0BP40-5BA2), S1: WAITS waits for standstill after M5, for the speed
after M3 and M4. What the manuals leave open is as bad as it can be here: another kind of S forgets the values of the
others, and a tool change leaves the spindle at an angle, with another S.
"""

from dataclasses import dataclass, field
from typing import Final

from simulators.nc.axes import Axes
from simulators.nc.synchronised import ProgramAlarm

BY_SPEED, IN_POSITION, AS_AXIS = 128, 32, 0
"""$AC_SPIND_STATE, bits 7 and 5."""
STANDS: Final = 5
_SIGN: Final = {3: 1.0, 4: -1.0, STANDS: 0.0}
_AT_CHANGE_DEG: Final = 77.0
NO_FLUID: Final = 9


@dataclass(slots=True)
class Spindle:
    axes: Axes
    direction: int = STANDS
    """$P_SDIR: 3, 4 or 5, as programmed last."""
    kind: int = 1
    """$P_S_TYPE: 0 no S yet, 1 speed, 2 cutting speed of the tool (SVC), 3 constant cutting speed (G96), 4 a wheel."""
    s: dict[int, float] = field(default_factory=lambda: {1: 0.0})
    """By kind."""
    switched: int = STANDS
    """$AC_SDIR: 3, 4 or 5, whoever switched it."""
    speed: float = 0.0
    """$AA_S: negative as M4 turns it."""
    mode: int = BY_SPEED
    angle_deg: float = 0.0
    by_hand: bool = False
    """Somebody else has it: no program stops it."""

    def programmed(self, value: float, kind: int) -> None:
        """S or SVC."""
        if value < 0.0:
            raise ProgramAlarm("14800: S is less than 0")
        self.kind, self.s = kind, {kind: value}

    def value(self, kind: int) -> float:
        """$P_S (1), $P_SVC (2), $P_CONSTCUT_S (3)."""
        return self.s.get(kind, 0.0)

    def left_constant_cutting(self) -> None:
        """G96 ends: what S is afterwards, the program has to say."""
        if self.kind == 3:
            self.programmed(0.0, 1)

    def forget(self) -> None:
        """A tool change may program another S."""
        if self.kind:
            self.programmed(0.0, 1)

    def switch(self, code: int) -> None:
        """M3, M4, M5 in the main run; it has neither its speed nor come to rest before somebody waits for it."""
        if not self.by_hand:
            self.switched, self.mode = code, BY_SPEED
        self.show()

    def wait(self) -> None:
        """WAITS: for the speed, or standstill."""
        if self.mode == BY_SPEED and not self.by_hand:
            self.speed = _SIGN[self.switched] * max(self.s.values(), default=0.0)
        self.show()

    def turn_to(self, angle_deg: float) -> None:
        """SPOS."""
        if not self.by_hand:
            self.mode, self.angle_deg, self.speed = IN_POSITION, angle_deg, 0.0
        self.show()

    def at_tool_change(self) -> None:
        """The builder's program for M6 turns it to its angle. Raises ProgramAlarm if it turns."""
        if self.speed or self.by_hand:
            raise ProgramAlarm("a tool is changed while the spindle turns")
        self.turn_to(_AT_CHANGE_DEG)

    @property
    def fluid(self) -> int:
        """7 or 8: it is on; what M7, M8 and M9 have switched."""
        return self.axes.fluid

    @fluid.setter
    def fluid(self, code: int) -> None:
        self.axes.fluid = code

    def show(self) -> None:
        """Tell the axes, whose moves are recorded with it."""
        position = f"{self.angle_deg:g}°" if self.mode == IN_POSITION else "stands"
        self.axes.spindle = "turns" if self.speed else position
