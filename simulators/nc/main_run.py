"""The main run of the emulated control: its programs' synchronised actions, in each interpolation cycle."""

from collections.abc import Iterator, Mapping, Sequence

from simulators.nc.synchronised import SynchronisedActions, SystemVariable

AC_PARAMS, AC_TIMERS = 64, 3
"""$AC_PARAM and $AC_TIMER of the channel: MD28254, MD28258."""

LINEAR = "XYZ"
"""Axes whose positions are lengths; they come first."""
LENGTHS = ("SA_TEMP_COMP_ABS_VALUE",)
"""Setting data in mm."""
POWER_ON = 4.0
"""$P_PROG_EVENT while PROG_EVENT runs after power on; 0: the operator has called a program."""


class MainRun:
    """One channel, from power on.

    Parameters
    ----------
    programs: what runs at power on, in order
    r: all R-parameters
    settings: axes' and tables' setting data by name without $$, of X, Y, Z or of tables 0, 1 ..
    axes: names, in the order of `cycle`'s positions
    ipo_s: interpolation cycle
    now_s: time of power on; None: when it is first asked for its cycles
    keeps_parameters: MD28255: RESET and the end of a program leave $AC_PARAM as it is

    Raises ProgramAlarm for a block that the control does not take.
    """

    def __init__(
        self,
        programs: Sequence[str],
        r: list[float],
        settings: Mapping[str, list[float]],
        axes: Sequence[str],
        ipo_s: float,
        now_s: float | None,
        *,
        keeps_parameters: bool = False,
    ) -> None:
        self._positions = [0.0] * len(axes)
        self._parameters, self._keeps = [0.0] * AC_PARAMS, keeps_parameters
        linear = range(sum(axis in LINEAR for axis in axes))
        self._began_s, self._cycles = now_s, 0
        self._event = [POWER_ON]
        self._tool = [0.0] * 4
        numbers = {axis: number for number, axis in enumerate(axes)}
        self.actions = SynchronisedActions(
            {
                "R": SystemVariable(r),
                "AC_PARAM": SystemVariable(self._parameters),
                "AA_IM": SystemVariable(self._positions, numbers, read_only=True, lengths=linear),
                "P_PROG_EVENT": SystemVariable(self._event, read_only=True),
                "AC_ACT_ORI_TOOL_LENGTH": SystemVariable(self._tool, read_only=True, lengths=range(1, 4)),
                **{
                    name: SystemVariable(
                        values,
                        numbers if name.startswith("SA_") else None,
                        "$$",
                        lengths=linear if name in LENGTHS else range(0),
                    )
                    for name, values in settings.items()
                },
            },
            [0.0] * AC_TIMERS,
            ipo_s,
        )
        for program in programs:
            self.actions.load(program)
        self._event[0] = 0.0

    def tool(self, length_mm: float) -> None:
        """Length of the tool in use along Z; 0: none is in force. The control shows where its tip is, below."""
        self._tool[3] = -length_mm

    def reset(self) -> None:
        """RESET, or the end of a part program: static actions and R-parameters stay, $AC_PARAM does not."""
        if not self._keeps:
            self._parameters[:] = [0.0] * AC_PARAMS

    def until(self, until_s: float) -> Iterator[float]:
        """The time of each interpolation cycle that is due."""
        if self._began_s is None:
            self._began_s = until_s
        while (time_s := self._began_s + (self._cycles + 1) * self.actions.ipo_s) <= until_s:
            self._cycles += 1
            yield time_s

    def next_cycle(self, positions: Sequence[float]) -> None:
        """The interpolation cycle that is due next, now."""
        if self._began_s is not None:
            self._cycles += 1
            self.cycle(positions)

    def cycle(self, positions: Sequence[float]) -> None:
        """One interpolation cycle. positions: of the axes, mm and degrees."""
        self._positions[:] = positions
        self.actions.cycle()
