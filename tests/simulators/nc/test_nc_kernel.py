"""The NC kernel without any protocol: probing as a state machine over R-parameters, compensation, loads."""

import math

import numpy as np
import pytest

from simulators.nc import Activity, CycleSettings, DayPart, LoadCase, MeanLoads, Nck, ReasonCode
from simulators.nc.cycle import CycleState
from simulators.nc.nck import (
    R_ANSWERS,
    R_OFFSETS,
    R_REASON,
    R_REQUEST,
    R_RESULT_OF,
    R_RESULTS,
    R_STATE,
    R_VALID_FOR,
    R_WITHDRAW,
)

CUT = MeanLoads(x=1000.0, y=500.0, z=200.0, a=1.0, c=10.0, spindle=5000.0, coolant=1.0)
QUIET = CycleSettings(noise_um=0.0)


class Drifting:
    """A machine whose sphere wanders in X by 1 µm per second."""

    def tool_deviation_um(
        self, time_s: float, x_mm: float, y_mm: float, z_mm: float, a_deg: float, c_deg: float
    ) -> tuple[float, float, float]:
        return time_s, 0.0, 0.0


def cutting(cycle: CycleSettings = QUIET, seed: int = 0, operation_s: float = 45.0) -> Nck:
    return Nck(
        Drifting(),
        LoadCase([DayPart(0.0, 1e6, Activity.ROUGHING, CUT)], operation_s=operation_s),
        cycle=cycle,
        seed=seed,
    )


def results(nck: Nck) -> np.ndarray:
    return np.array(nck.r[R_RESULTS : R_RESULTS + 18]).reshape(6, 3)


def test_the_spheres_nominal_centre_follows_the_rotary_axes() -> None:
    settings = CycleSettings(radius_mm=100.0, height_mm=30.0)
    expected = [(100, 0, 30), (0, 100, 30), (-100, 0, 30), (0, -100, 30), (100, -30, 0), (100, 30, 0)]
    for pose, centre in enumerate(expected):
        assert settings.nominal_centre_mm(pose) == pytest.approx(centre, abs=1e-12)


def test_touches_are_spread_over_the_cycle_and_see_the_machine_at_their_own_time() -> None:
    nck = cutting()
    nck.write_r(R_REQUEST, 1.0, 10.0)
    nck.advance(1000.0)  # the loop woke late; touches count at the time they were due
    nominal = np.array([QUIET.nominal_centre_mm(pose) for pose in range(6)])
    touched_at = (results(nck) - nominal)[:, 0] * 1e3
    np.testing.assert_allclose(touched_at, 45.0 + 10.0 + np.arange(1, 7) * 100.0 / 6.0, atol=1e-6)


def test_results_come_with_their_number_and_go_when_the_next_cycle_begins() -> None:
    nck = cutting()
    nck.write_r(R_REQUEST, 1.0, 10.0)
    nck.advance(200.0)
    assert (nck.r[R_ANSWERS], nck.r[R_STATE], nck.r[R_RESULT_OF]) == (1, CycleState.DONE, 1)
    nck.write_r(R_REQUEST, 2.0, 200.0)
    nck.advance(226.0)
    assert (nck.r[R_ANSWERS], nck.r[R_STATE], nck.r[R_RESULT_OF]) == (2, CycleState.ACCEPTED, 0)


def test_a_request_during_a_cycle_waits_for_its_end() -> None:
    nck = cutting()
    nck.write_r(R_REQUEST, 1.0, 10.0)
    nck.write_r(R_REQUEST, 2.0, 60.0)
    nck.advance(164.0)
    assert nck.r[R_ANSWERS] == 1
    nck.advance(166.0)
    assert (nck.r[R_ANSWERS], nck.r[R_STATE]) == (1, CycleState.DONE)
    nck.advance(400.0)
    assert (nck.r[R_ANSWERS], nck.r[R_STATE]) == (2, CycleState.DONE)


def test_a_request_that_nobody_waits_for_any_more_is_refused() -> None:
    nck = cutting(operation_s=600.0)
    nck.write_r(R_VALID_FOR, 100.0, 10.0)
    nck.write_r(R_REQUEST, 1.0, 10.0)
    nck.advance(109.0)
    assert nck.r[R_ANSWERS] == 0
    nck.advance(110.0)
    assert (nck.r[R_ANSWERS], nck.r[R_STATE], nck.r[R_REASON]) == (1, CycleState.REFUSED, ReasonCode.EXPIRED)
    nck.advance(2000.0)
    assert nck.r[R_STATE] == CycleState.REFUSED


def test_an_answered_number_written_again_starts_nothing() -> None:
    nck = cutting()
    nck.write_r(R_REQUEST, 1.0, 0.0)
    nck.advance(200.0)
    nck.write_r(R_REQUEST, 1.0, 200.0)
    assert nck.next_event_s is None


def test_a_withdrawn_cycle_lets_the_program_go_on() -> None:
    nck = cutting()
    nck.write_r(R_REQUEST, 1.0, 0.0)
    nck.advance(50.0)
    assert nck.state(50.0).probing
    nck.write_r(R_WITHDRAW, 1.0, 50.0)
    assert (nck.r[R_STATE], nck.r[R_REASON]) == (CycleState.FAILED, ReasonCode.WITHDRAWN)
    assert not nck.state(51.0).probing
    assert nck.state(51.0).loads == CUT


def test_an_alarm_stops_the_axes() -> None:
    nck = cutting()
    nck.raise_alarm(4711, 5.0)
    assert nck.state(6.0).loads == MeanLoads()
    nck.clear_alarms(7.0)
    assert nck.state(8.0).loads == CUT


def test_probing_noise_is_of_the_stated_size_and_depends_on_the_time_alone() -> None:
    deviations = []
    for start in np.arange(0.0, 20_000.0, 200.0):
        nck = cutting(CycleSettings(noise_um=1.0), seed=3)
        nck.write_r(R_REQUEST, 1.0, start)
        nck.advance(start + 200.0)
        clean = cutting()
        clean.write_r(R_REQUEST, 1.0, start)
        clean.advance(start + 200.0)
        deviations.append((results(nck) - results(clean)) * 1e3)
    noise = np.array(deviations)
    assert np.std(noise) == pytest.approx(1.0, abs=0.05)
    assert abs(np.mean(noise)) < 0.1

    busy = cutting(CycleSettings(noise_um=1.0), seed=3)
    for number, start in enumerate((0.0, 4000.0), start=1):
        busy.write_r(R_REQUEST, float(number), start)
        busy.advance(start + 200.0)
    clean = cutting()
    clean.write_r(R_REQUEST, 1.0, 4000.0)
    clean.advance(4200.0)
    np.testing.assert_allclose((results(busy) - results(clean)) * 1e3, noise[20], atol=1e-9)


def test_compensation_adds_up_offset_slope_and_parameters() -> None:
    nck = cutting()
    nck.k0_mm[0] = -0.010
    nck.slope[2], nck.reference_mm[2] = 20e-6, 100.0
    nck.r[R_OFFSETS + 1] = 0.003
    assert nck.shift_um((50.0, 0.0, 300.0)) == pytest.approx((10.0, 3.0, -4.0))


@pytest.mark.slow
def test_mean_loads_are_what_a_fine_sum_gives_cycles_included() -> None:
    nck = Nck(Drifting(), LoadCase.random(4, 7200.0), cycle=QUIET)
    for number, start in enumerate((100.0, 400.0, 1000.0), start=1):
        nck.advance(start)
        nck.write_r(R_REQUEST, float(number), start)
    nck.advance(1100.0)  # the third is under way
    times = np.linspace(150.0, 1100.0, 95_001)
    sampled = np.array([nck.state(t).loads.as_tuple() for t in times])
    mean = np.trapezoid(sampled, times, axis=0) / (times[-1] - times[0])
    np.testing.assert_allclose(nck.mean_loads(150.0, 1100.0).as_tuple(), mean, rtol=1e-3, atol=1e-6)
    assert any(nck.state(t).probing for t in times[::1000])


def test_positions_stay_in_reach_and_move_at_their_speed() -> None:
    nck = Nck(Drifting(), LoadCase.random(9, 86400.0), cycle=QUIET)
    for block in nck.program.blocks[:40]:
        one, two = (nck.state(block.start_s + t).positions for t in (10.0, 10.001))
        assert abs(one["X"]) <= 150.0
        assert abs(one["A"]) <= 60.0
        assert abs(two["X"] - one["X"]) == pytest.approx(block.loads.x / 60.0 * 0.001, abs=1e-6)
        turned = math.fmod(two["C"] - one["C"] + 360.0, 360.0)
        assert turned == pytest.approx(block.loads.c * 6.0 * 0.001, abs=1e-6)
