"""The component talc_errors of deploy/nc/linuxcnc: its C compiled alone, one call a servo period.

It is compared with the method's kinematics, and tried in every situation that must never make a step.
"""

import ctypes
import math
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from simulators.linuxcnc.machine import FILES
from talc import kinematics
from talc.frame import FloatArray
from tests.benches.waits import turns

# The servo thread of a LinuxCNC around the core of the component talc_errors, compiled alone: one call a period.


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


WARM = np.array([3.0, -88.8, 10.0, 4.0, 20.0, 12.6, 30.0, -25.0, 15.0])
RADIUS_MM, REACH_MM = 120.0, (300.0, 400.0)
SLEW_UM_PER_MS = 0.01


def random_poses(count: int, seed: int) -> FloatArray:
    """(count, 5) X Y Z in mm, A C in rad, within the reach."""
    rng = np.random.default_rng(seed)
    x, across, turn = rng.uniform(-300, 300, count), rng.uniform(0, 400, count), rng.uniform(0, 2 * math.pi, count)
    a, c = rng.uniform(-2.1, 2.1, count), rng.uniform(-7, 7, count)
    return np.column_stack([x, across * np.cos(turn), across * np.sin(turn), a, c])


def at_rest() -> ServoThread:
    thread = ServoThread(RADIUS_MM, REACH_MM)
    thread.input.tip[:], thread.input.a = (150.0, -80.0, 120.0), math.radians(30.0)
    return thread


def shift_at(thread: ServoThread, errors: FloatArray) -> FloatArray:
    where = np.array([*thread.input.tip, thread.input.a, 0.0])
    return kinematics.tcp_offsets(errors, where, RADIUS_MM * 1e-3)


def test_the_control_s_geometry_is_the_method_s() -> None:
    rng = np.random.default_rng(1)
    for pose in random_poses(500, 2):
        errors = rng.normal(0, 30, 9)
        theirs = kinematics.tcp_offsets(errors, pose, RADIUS_MM * 1e-3)
        assert offsets(errors, pose[:3], pose[3], RADIUS_MM) == pytest.approx(theirs, abs=1e-9)


def test_the_size_of_a_change_is_the_most_that_any_point_of_the_travel_can_move() -> None:
    largest = kinematics.largest_offsets((0.3, 0.4), 0.12)
    reached = np.zeros((3, 9))
    for pose in random_poses(3000, 3):
        reached = np.maximum(reached, np.abs(kinematics.offset_matrix(pose, 0.12)))
    assert (reached <= largest + 1e-12).all()
    assert (reached >= 0.9 * largest).all(), "and no more than that"
    rng = np.random.default_rng(4)
    for errors in (*np.eye(9), *rng.normal(0, 10, (200, 9))):
        expected = (largest @ np.abs(errors)).max()
        assert size(errors, RADIUS_MM, np.array(REACH_MM)) == pytest.approx(expected, rel=1e-12)


def test_the_errors_are_slewed_so_that_no_point_moves_faster_than_the_slew() -> None:
    thread = at_rest()
    thread.input.slew = thread.input.rate = 100.0
    thread.want(WARM)
    before, largest = thread.errors, kinematics.largest_offsets((0.3, 0.4), 0.12)
    periods = 0
    for _ in turns():
        thread.turn()
        moved = largest @ np.abs(thread.errors - before)
        assert moved.max() <= 0.1 * (1 + 1e-9)
        before, periods = thread.errors, periods + 1
        if np.array_equal(before, WARM):
            break
    assert periods * 0.1 == pytest.approx((largest @ np.abs(WARM)).max(), abs=0.11), "and not slower"
    assert thread.turn()[0] == pytest.approx(shift_at(thread, WARM), abs=1e-9)


def test_where_the_tool_is_counts_in_the_same_period() -> None:
    thread = at_rest()
    thread.want(WARM)
    thread.settle()
    for pose in random_poses(200, 5):
        thread.input.tip[:], thread.input.a = pose[:3].tolist(), float(pose[3])
        there = np.clip(shift_at(thread, WARM), -200, 200)
        assert thread.turn()[0] == pytest.approx(there, abs=1e-9)


def test_no_offset_is_beyond_the_gateway_s_bound_nor_the_control_s() -> None:
    thread = at_rest()
    thread.input.bound[:] = (5.0, 40.0, 1000.0)
    thread.input.limit = 60.0
    thread.want(WARM * 3)
    thread.settle()
    for pose in random_poses(200, 6):
        thread.input.tip[:], thread.input.a = pose[:3].tolist(), float(pose[3])
        assert (np.abs(thread.turn()[0]) <= (5.0, 40.0, 60.0)).all()


def homes_again(thread: ServoThread) -> None:
    thread.input.homed = 0


def homed_elsewhere(thread: ServoThread) -> None:
    thread.input.homed = 1
    thread.input.tip[:] = (-300.0, 200.0, -100.0)


def longer_tool(thread: ServoThread) -> None:
    thread.input.tool[2] += 120.0
    thread.input.tip[2] -= 120.0


def narrower_bound(thread: ServoThread) -> None:
    thread.input.bound[:] = (2.0, 2.0, 2.0)


def ends_probing_elsewhere(thread: ServoThread) -> None:
    thread.input.hold = 1
    thread.turn()
    thread.input.tip[:], thread.input.a = (-250.0, 100.0, 300.0), -1.2
    assert np.ptp(thread.turn(50), axis=0).max() == 0.0
    thread.input.hold = 0


@pytest.mark.parametrize("event", [homes_again, longer_tool, narrower_bound, ends_probing_elsewhere])
def test_what_would_be_a_step_is_a_ramp_at_half_of_the_slew(event: Callable[[ServoThread], None]) -> None:
    thread = at_rest()
    thread.want(WARM)
    thread.settle()
    before = np.array(list(thread.state.out))
    event(thread)
    rows = np.vstack([before, thread.turn(60000)])
    assert np.abs(np.diff(rows, axis=0)).max() == pytest.approx(SLEW_UM_PER_MS / 2, rel=1e-9)
    end = shift_at(thread, WARM) * thread.input.homed
    assert rows[-1] == pytest.approx(np.clip(end, -thread.input.bound[0], thread.input.bound[0]), abs=1e-9)


def test_a_ramp_and_new_errors_together_keep_to_the_slew() -> None:
    thread = at_rest()
    thread.want(WARM)
    thread.settle()
    rng = np.random.default_rng(7)
    last = np.array(list(thread.state.out))
    for _ in range(300):
        longer_tool(thread) if rng.random() < 0.5 else narrower_bound(thread)
        thread.input.tool[2] = float(rng.uniform(0, 150))
        thread.input.bound[:] = rng.uniform(1, 200, 3).tolist()
        thread.input.homed = int(rng.random() < 0.7)
        thread.input.hold = int(rng.random() < 0.2)
        thread.want(rng.normal(0, 30, 9))
        rows = np.vstack([last, thread.turn(20)])
        assert np.abs(np.diff(rows, axis=0)).max() <= SLEW_UM_PER_MS * (1 + 1e-6)
        last = rows[-1]


def test_nothing_is_in_force_before_homing_and_it_begins_at_zero() -> None:
    thread = at_rest()
    thread.input.homed = 0
    thread.want(WARM)
    assert np.abs(thread.turn(5000)).max() == 0.0
    homed_elsewhere(thread)
    rows = np.vstack([np.zeros(3), thread.turn(25000)])
    assert np.abs(np.diff(rows, axis=0)).max() <= SLEW_UM_PER_MS * (1 + 1e-9)
    assert rows[-1] == pytest.approx(shift_at(thread, WARM), abs=1e-9)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_not_a_number_moves_nothing(value: float) -> None:
    thread = at_rest()
    thread.want(WARM)
    thread.settle()
    before = np.array(list(thread.state.out))
    for field in ("wanted", "tip"):
        kept = getattr(thread.input, field)[1]
        getattr(thread.input, field)[1] = value
        assert (thread.turn(3) == before).all()
        getattr(thread.input, field)[1] = kept
        assert thread.turn()[0] == pytest.approx(before, abs=1e-12)


def test_a_rate_of_zero_holds_the_errors_while_the_tool_goes_on() -> None:
    thread = at_rest()
    thread.want(WARM)
    thread.settle()
    thread.input.rate = 0.0
    thread.want(np.zeros(9))
    thread.input.tip[0] = -100.0
    assert thread.turn(100)[-1] == pytest.approx(shift_at(thread, WARM), abs=1e-9)
