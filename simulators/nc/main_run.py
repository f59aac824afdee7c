"""The main run of the emulated control: its programs' synchronised actions, in each interpolation cycle."""

from collections.abc import Iterator, Mapping, Sequence

from simulators.nc.synchronised import SynchronisedActions, SystemVariable

AC_PARAMS, AC_TIMERS = 64, 3
"""$AC_PARAM and $AC_TIMER of the channel: MD28254, MD28258."""

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
    ) -> None:
        self._positions = [0.0] * len(axes)
        self._began_s, self._cycles = now_s, 0
        self._event = [POWER_ON]
        numbers = {axis: number for number, axis in enumerate(axes)}
        self.actions = SynchronisedActions(
            {
                "R": SystemVariable(r),
                "AC_PARAM": SystemVariable([0.0] * AC_PARAMS),
                "AA_IM": SystemVariable(self._positions, numbers, read_only=True),
                "P_PROG_EVENT": SystemVariable(self._event, read_only=True),
                **{
                    name: SystemVariable(values, numbers if name.startswith("SA_") else None, "$$")
                    for name, values in settings.items()
                },
            },
            [0.0] * AC_TIMERS,
            ipo_s,
        )
        for program in programs:
            self.actions.load(program)
        self._event[0] = 0.0

    def until(self, until_s: float) -> Iterator[float]:
        """The time of each interpolation cycle that is due."""
        if self._began_s is None:
            self._began_s = until_s
        while (time_s := self._began_s + (self._cycles + 1) * self.actions.ipo_s) <= until_s:
            self._cycles += 1
            yield time_s

    def cycle(self, positions: Sequence[float]) -> None:
        """One interpolation cycle. positions: of the axes, mm and degrees."""
        self._positions[:] = positions
        self.actions.cycle()
