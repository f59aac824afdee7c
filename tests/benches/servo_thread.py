"""The servo thread of a LinuxCNC around the core of the component talc_errors, compiled alone: one call a period."""

import ctypes
import subprocess
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from simulators.linuxcnc.machine import FILES
from talc.frame import FloatArray

_ERRORS = 9
_SOURCE = """#include "talc_errors.h"
void step(TalcState *s, const TalcInput *in) { talc_step(s, in); }
void offsets(const double *e, const double *tip, double a, double radius, double *out) {
    talc_offsets(e, tip, a, radius, out);
}
double size(const double *e, double radius, const double *reach) { return talc_size(e, radius, reach); }
unsigned long sizes(int input) { return input ? sizeof(TalcInput) : sizeof(TalcState); }
"""


class ServoInput(ctypes.Structure):
    """As TalcInput."""

    _fields_ = (
        ("wanted", ctypes.c_double * _ERRORS),
        ("tip", ctypes.c_double * 3),
        ("a", ctypes.c_double),
        ("tool", ctypes.c_double * 3),
        ("bound", ctypes.c_double * 3),
        ("limit", ctypes.c_double),
        ("radius", ctypes.c_double),
        ("reach", ctypes.c_double * 2),
        ("slew", ctypes.c_double),
        ("rate", ctypes.c_double),
        ("dt", ctypes.c_double),
        ("homed", ctypes.c_int),
        ("hold", ctypes.c_int),
    )


class ServoState(ctypes.Structure):
    """As TalcState; all zero when LinuxCNC starts."""

    _fields_ = (
        ("errors", ctypes.c_double * _ERRORS),
        ("out", ctypes.c_double * 3),
        ("bridge", ctypes.c_double * 3),
        ("tool", ctypes.c_double * 3),
        ("bound", ctypes.c_double * 3),
        ("homed", ctypes.c_int),
        ("hold", ctypes.c_int),
    )


@cache
def _core() -> ctypes.CDLL:
    """Raises subprocess.CalledProcessError."""
    with TemporaryDirectory() as folder:
        source, made = Path(folder) / "core.c", Path(folder) / "core.so"
        source.write_text(_SOURCE)
        strict = ["-std=c11", "-O1", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"]
        subprocess.run(["gcc", *strict, f"-I{FILES}", "-o", made, source, "-lm"], check=True)
        core = ctypes.CDLL(str(made))
    core.size.restype = ctypes.c_double
    core.offsets.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_void_p]
    core.size.argtypes = [ctypes.c_void_p, ctypes.c_double, ctypes.c_void_p]
    core.sizes.restype = ctypes.c_ulong
    assert core.sizes(1) == ctypes.sizeof(ServoInput)
    assert core.sizes(0) == ctypes.sizeof(ServoState)
    return core


class ServoThread:
    """Homed, with a bound of 200 µm, a slew of 10 µm/s and a period of 1 ms; a test changes `input`."""

    def __init__(self, radius_mm: float = 120.0, reach_mm: tuple[float, float] = (300.0, 400.0)) -> None:
        self.state, self.input = ServoState(), ServoInput()
        self.input.radius, self.input.reach[:] = radius_mm, reach_mm
        self.input.limit, self.input.bound[:] = 200.0, (200.0, 200.0, 200.0)
        self.input.slew = self.input.rate = 10.0
        self.input.dt, self.input.homed = 1e-3, 1

    def want(self, errors: FloatArray) -> None:
        self.input.wanted[:] = errors.tolist()

    def settle(self) -> None:
        """Put what is wanted in force at once, as if the slew had had the time."""
        self.state.errors[:] = self.input.wanted[:]
        self.state.homed, self.state.hold = self.input.homed, 0
        self.state.tool[:], self.state.bound[:] = self.input.tool[:], self.input.bound[:]
        self.state.bridge[:] = (0.0, 0.0, 0.0)
        self.turn()

    def turn(self, periods: int = 1) -> FloatArray:
        """(periods, 3) offsets, µm."""
        rows = []
        for _ in range(periods):
            _core().step(ctypes.byref(self.state), ctypes.byref(self.input))
            rows.append(list(self.state.out))
        return np.array(rows)

    @property
    def errors(self) -> FloatArray:
        return np.array(list(self.state.errors))


def offsets(errors: FloatArray, tip_mm: FloatArray, a: float, radius_mm: float) -> FloatArray:
    """(3,) of the component, µm."""
    given, at, out = (np.ascontiguousarray(v, dtype=np.float64) for v in (errors, tip_mm, np.zeros(3)))
    _core().offsets(given.ctypes.data, at.ctypes.data, a, radius_mm, out.ctypes.data)
    return out


def size(errors: FloatArray, radius_mm: float, reach_mm: FloatArray) -> float:
    """The most that the errors can move any axis, µm."""
    given, reach = (np.ascontiguousarray(v, dtype=np.float64) for v in (errors, reach_mm))
    return float(_core().size(given.ctypes.data, radius_mm, reach.ctypes.data))
