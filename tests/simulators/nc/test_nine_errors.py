"""What the emulated control does with nine errors, compared with the generated program in an interpreter."""

from collections.abc import Callable

import numpy as np
import pytest

from drivers.sinumerik.programs import ErrorTerms, errors_program
from drivers.sinumerik.settings import OffsetRoute, SinumerikSettings
from simulators.nc import Activity, CycleSettings, DayPart, FollowingTerms, LoadCase, MeanLoads, Nck
from simulators.nc.nck import R_REQUEST, R_WITHDRAW
from simulators.nc.nine_errors import R_COUNT_WITH_ERRORS, R_CYCLE, R_ECHO, R_IN_FORCE, R_PROBED, R_TERMS, R_WANTED
from simulators.nc.watchdog import R_BEAT, R_OWNER, R_RAMP, R_SILENCE, R_WATCH
from talc.kinematics import tcp_offsets
from tests.benches.emulated_bench import Rigid
from tests.benches.error_program import WARM

IPO_S = 0.01
SLEW_UM_PER_S, RADIUS_MM, BOUND_UM = 2.0, 120.0, (2.0, 1.5, 1.0)
TRAVEL = ((-200.0, 200.0), (-150.0, 150.0), (0.0, 250.0))

CYCLE = CycleSettings(noise_um=0.0, duration_s=40.05, approach_s=2.05)
"""Its states begin and end between the moments at which the two are compared."""
DAY = LoadCase([DayPart(0.0, 1e6, Activity.PAUSE, MeanLoads(x=900.0, y=700.0, z=500.0, a=0.5, c=3.0))])
CLOSE_UM = 5 * SLEW_UM_PER_S * IPO_S
"""The program sees a write in its next cycle, and the end of a probing cycle in the one after."""


def interpreted() -> Nck:
    """A control that runs the program of `talc-gateway nc sinumerik-files`."""
    settings = SinumerikSettings(
        security="none",
        url="opc.tcp://nc",
        origin_tool_mm=0.0,
        compensation=OffsetRoute(route="errors", travel_mm=TRAVEL),
    )
    text = errors_program(settings, ErrorTerms(SLEW_UM_PER_S, RADIUS_MM, BOUND_UM))
    return Nck(Rigid(), DAY, cycle=CYCLE, programs=[text], ipo_s=IPO_S, r_count=R_COUNT_WITH_ERRORS)


def meant() -> Nck:
    terms = FollowingTerms(SLEW_UM_PER_S, RADIUS_MM, BOUND_UM, (200.0, float(np.hypot(150.0, 250.0))))
    return Nck(Rigid(), DAY, cycle=CYCLE, ipo_s=IPO_S, errors=terms)


def claim(nck: Nck, ramp_um_per_s: float = 1.0) -> None:
    for number, value in ((R_SILENCE, 4.05), (R_RAMP, ramp_um_per_s * 1e-3), (R_OWNER, 7.0), (R_BEAT, 1.0)):
        nck.write_r(number, value, 0.05)


def want(nck: Nck, errors: np.ndarray[tuple[int], np.dtype[np.float64]], now_s: float) -> None:
    for i, value in enumerate(errors.tolist()):
        nck.write_r(R_WANTED + i, value, now_s)


@pytest.mark.slow
@pytest.mark.parametrize("ramp_um_per_s", [1.0, 0.0], ids=["zero", "hold"])
def test_the_emulated_control_does_what_the_program_does(ramp_um_per_s: float) -> None:
    """Targets beyond the bound, a cycle with a gateway, one without, a withdrawn one, a value that is not a number,
    silence."""
    both = real, as_meant = interpreted(), meant()
    assert as_meant.r[99:] == pytest.approx(real.r[99:]), "version and terms"
    wanted = {
        5: WARM / 8,
        15: -WARM / 4,
        70: WARM * 3,
        94: np.where(np.arange(9) == 4, np.nan, WARM),
        95: WARM / 8,
        128: -WARM,
    }
    quiet = range(100, 125)
    seen, bounded = set(), 0
    for nck in both:
        claim(nck, ramp_um_per_s)
    for number in range(1, 1500):
        now = number * 0.1
        for nck in both:
            nck.advance(now)
        seen.add((real.r[R_WATCH], real.r[R_CYCLE]))
        assert real.r[R_WATCH] == as_meant.r[R_WATCH], now
        assert real.k0_mm == pytest.approx(as_meant.k0_mm, abs=CLOSE_UM * 1e-3), now
        assert real.r[R_IN_FORCE:R_ECHO] == pytest.approx(as_meant.r[R_IN_FORCE:R_ECHO], abs=CLOSE_UM), now
        assert real.r[R_PROBED:R_TERMS] == pytest.approx(as_meant.r[R_PROBED:R_TERMS], abs=CLOSE_UM * 1e-3), now
        bounded += bool((np.abs(real.k0_mm) > np.array(BOUND_UM) * 0.999999e-3).any())
        for nck in both:
            if number % 10 == 0 and number // 10 not in quiet:
                nck.write_r(R_BEAT, float(number), now)
            if number % 10 == 0 and number // 10 in wanted:
                want(nck, wanted[number // 10], now)
            if number in (100, 800, 1130):
                nck.write_r(R_REQUEST, float(number), now)
            if number == 900:
                nck.write_r(R_WITHDRAW, 800.0, now)
            if number == 1430:  # while the axes stand at a pose
                nck.write_r(R_OWNER, 0.0, now)
    assert {(1.0, 2.0), (2.0, 2.0), (1.0, 3.0), (1.0, 5.0)} <= seen, "alive or silent, and the cycle's state"
    assert bounded > 10


@pytest.mark.slow
@pytest.mark.parametrize("make", [interpreted, meant])
def test_what_stood_still_in_a_cycle_is_right_where_the_cycle_begins_and_ends(make: Callable[[], Nck]) -> None:
    """So the offsets fit wherever the axes are before it, on the way to the sphere, and at once after it."""
    nck, errors, stood = make(), WARM / 40.0, []
    claim(nck)
    fitted = dict.fromkeys((0.0, 1.0, 3.0), 0)
    for number in range(1, 800):
        now = number * 0.1
        nck.advance(now)
        nck.write_r(R_BEAT, float(number), now)
        if number == 1:
            want(nck, errors, now)
        if number == 200:
            nck.write_r(R_REQUEST, 1.0, now)
        shift_um = -1e3 * np.array(nck.k0_mm)
        if nck.r[R_CYCLE] == 2.0:
            stood.append(shift_um)
        elif number > 150:  # the errors are in force
            at = nck.state(now).positions
            place = np.array([at["X"], at["Y"], at["Z"], np.radians(at["A"]), np.radians(at["C"])])
            assert shift_um == pytest.approx(tcp_offsets(errors, place, RADIUS_MM * 1e-3), abs=0.01), now
            fitted[nck.r[R_CYCLE]] += 1
    assert min(fitted.values()) >= 20, "before the request, on the way to the sphere, and after the cycle"
    assert len(stood) > 300
    assert np.ptp(stood, axis=0).max() < 1e-9
    assert stood[0] == pytest.approx(1e3 * np.array(nck.r[R_PROBED:R_TERMS]))
