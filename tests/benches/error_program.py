"""The program of route `errors`, run as it is written: the emulated control with it, and what its offsets do."""

from collections.abc import Sequence

import numpy as np

from drivers.sinumerik.programs import ErrorTerms, errors_program
from drivers.sinumerik.settings import OffsetRoute, SinumerikSettings
from simulators.nc.main_run import MainRun
from talc.frame import FloatArray

RADIUS_MM, SLEW_UM_PER_S, BOUND_UM = 120.0, 1.0, (60.0, 50.0, 70.0)
ORIGIN_MM = (10.0, -20.0, 30.0)
TRAVEL = ((-200.0, 250.0), (-200.0, 200.0), (0.0, 300.0))
R_COUNT, IPO_S = 137, 0.01
TERMS = ErrorTerms(SLEW_UM_PER_S, RADIUS_MM, BOUND_UM)
WARM = np.array([3.0, -22.0, 10.0, 4.0, 8.0, 6.0, 30.0, -25.0, 15.0])
BEAT, OWNER, SILENCE, STATE, RAMP, PROBING = 94, 93, 95, 96, 97, 65
WANTED, IN_FORCE, PROBED, ECHO = 100, 110, 120, 119


def settings(url: str = "opc.tcp://nc", signs: tuple[int, int, int] | None = None) -> SinumerikSettings:
    compensation = OffsetRoute(route="errors", travel_mm=TRAVEL, signs=signs)
    return SinumerikSettings(
        security="none", url=url, origin_mm=ORIGIN_MM, origin_tool_mm=0.0, compensation=compensation
    )


def program(slew_um_per_s: float = SLEW_UM_PER_S, bound_um: tuple[float, float, float] = BOUND_UM) -> str:
    return errors_program(settings(), ErrorTerms(slew_um_per_s, RADIUS_MM, bound_um))


class ErrorChannel:
    """One channel of a control with nothing but the program: no protocol, one interpolation cycle a turn."""

    def __init__(self, text: str) -> None:
        self.r, self.k0_mm = [0.0] * R_COUNT, [0.0] * 5
        self.position: FloatArray = np.array([150.0, -80.0, 120.0, 30.0, 70.0])
        """X Y Z A C in machine coordinates, mm and degrees."""
        self.run = MainRun([text], self.r, {"SA_TEMP_COMP_ABS_VALUE": self.k0_mm}, "XYZAC", IPO_S, 0.0)

    def call(self, text: str) -> None:
        """Call it, by hand or at the end of a part program."""
        self.run.actions.load(text)

    @property
    def protected(self) -> range:
        """Numbers of actions that MD21240 protects."""
        return self.run.actions.protected

    @protected.setter
    def protected(self, numbers: range) -> None:
        self.run.actions.protected = numbers

    def alive(self, ramp_um_per_s: float = SLEW_UM_PER_S, silence_s: float = 1e9) -> None:
        self.r[SILENCE], self.r[RAMP], self.r[OWNER] = silence_s, ramp_um_per_s * 1e-3, 7.0
        self.beat()

    def beat(self) -> None:
        self.r[BEAT] += 1.0

    def want(self, errors: Sequence[float] | FloatArray) -> None:
        self.r[WANTED : WANTED + 9] = [float(v) for v in errors]

    def settle(self, errors: Sequence[float] | FloatArray) -> None:
        """Bring the errors into force at once, as after a long time."""
        self.want(errors)
        self.r[IN_FORCE : IN_FORCE + 9] = self.r[WANTED : WANTED + 9]
        self.turn()

    @property
    def in_force(self) -> FloatArray:
        return np.array(self.r[IN_FORCE : IN_FORCE + 9])

    @property
    def shift_um(self) -> FloatArray:
        """What the control makes of SD43900: it removes it."""
        return -1e3 * np.array(self.k0_mm[:3])

    def turn(self, cycles: int = 1) -> FloatArray:
        """(cycles, 3) shifts."""
        found = []
        for _ in range(cycles):
            self.run.cycle(self.position.tolist())
            found.append(self.shift_um)
        return np.array(found)

    def tip(self) -> FloatArray:
        """(5,) for talc.kinematics."""
        return np.array([*(self.position[:3] - ORIGIN_MM), *np.deg2rad(self.position[3:])])
