"""The interpreter of synchronised actions; it runs the supplied watchdog, which is compared with its intended
behaviour."""

import itertools
from pathlib import Path

import pytest

from simulators.nc import Activity, DayPart, LoadCase, MeanLoads, Nck
from simulators.nc.synchronised import ProgramAlarm, SynchronisedActions, SystemVariable
from simulators.nc.watchdog import R_BEAT, R_OWNER, R_RAMP, R_SILENCE, R_SLOPE_RAMP, R_WATCH
from tests.benches.emulated_bench import Rigid

FOLDER = Path(__file__).parents[3] / "deploy" / "nc" / "sinumerik"
START, SLOPES = ((FOLDER / f"TALC_{name}.SPF").read_text() for name in ("START", "SLOPES"))
IPO_S = 0.01


def channel(program: str) -> tuple[SynchronisedActions, list[float]]:
    r = [0.0] * 10
    actions = SynchronisedActions({"R": SystemVariable(r), "AC_PARAM": SystemVariable([0.0] * 4)}, [0.0] * 2, IPO_S)
    actions.load(program)
    return actions, r


def value_of(expression: str) -> float:
    actions, r = channel(f"R[1] = 3 R2 = 4\nIDS=1 DO $R[0] = {expression}")
    actions.cycle()
    return r[0]


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("1 + 2 * $R[1]", 7.0),
        ("8 / 2 / 2 - 1 - 1", 0.0),
        ("(1 + 2) * ($R[1] - 1)", 6.0),
        ("SIN(30) + COS(60)", 1.0),
        ("SQRT(POT($R[1]) + POT($R[2]))", 5.0),
        ("ABS(0 - 2.5) + TRUNC(2.9)", 4.5),
    ],
)
def test_an_expression_has_the_value_of_arithmetic(expression: str, expected: float) -> None:
    assert value_of(expression) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("block", "cause"),
    [
        ("IDS=1 DO $R[0] = MINVAL($R[1], 2)", "not a function of synchronised actions"),
        ("IDS=1 WHENEVER $R[1] == 2 AND $R[2] > 0 DO $R[0] = 1", "set parentheses"),
        ("IDS=1 WHENEVER $R[1] DO $R[0] = 1", "the condition is a number"),
        ("IDS=1 DO $R[0] = ($R[1] > 2)", "set parentheses"),
        ("IDS=1 DO R[0] = 1", r"expected \$R"),
        ("IDS=1 DO $R[10] = 1", "has none"),
        ("IDS=1 DO $AC_PARAM[4] = 1", "has none"),
        ("IDS=256 DO $R[0] = 1", "1 to 255"),
        ("IDS=1 DO $R[0] = 1\nIDS=1 DO $R[0] = 2", "line 2: IDS=1 is already defined"),
        ("IDS=1 DO $$SA_UNKNOWN[X] = 1", "not known"),
        ("IDS=1 DO $R[0] = 1 + ", "ends too early"),
        (f"IDS=1 DO $R[0] = {' + '.join(['1'] * 130)}", "at most 512"),
    ],
)
def test_what_a_control_would_not_take_is_an_alarm(block: str, cause: str) -> None:
    with pytest.raises(ProgramAlarm, match=cause):
        channel(block)


def test_actions_run_in_the_order_of_their_numbers_and_see_each_other_s_results() -> None:
    actions, r = channel("IDS=7 DO $R[1] = $R[0] + 1\nIDS=3 WHENEVER $R[0] < 2 DO $R[0] = $R[0] + 1")
    seen = []
    for _ in range(3):
        actions.cycle()
        seen.append((r[0], r[1]))
    assert seen == [(1.0, 2.0), (2.0, 3.0), (2.0, 3.0)]


def test_a_timer_counts_seconds_from_when_it_is_set() -> None:
    actions, r = channel("IDS=1 WHENEVER $R[1] == 1 DO $AC_TIMER[1] = 0 $R[1] = 0\nIDS=2 DO $R[0] = $AC_TIMER[1]")
    for _ in range(5):
        actions.cycle()
    assert r[0] == 0.0
    r[1] = 1.0
    for _ in range(101):
        actions.cycle()
    assert r[0] == pytest.approx(1.0)


def control(*programs: str) -> Nck:
    program = LoadCase([DayPart(0.0, 1e6, Activity.ROUGHING, MeanLoads(x=600.0))])
    return Nck(Rigid(), program, programs=programs, ipo_s=IPO_S)


def test_the_supplied_watchdog_does_what_the_emulated_one_does() -> None:
    """Beats, silence, a beat within the ramp, a gateway that leaves, values of either sign, the end at zero."""
    real, meant = control(START, SLOPES), control()
    for nck in (real, meant):
        for number, value in ((R_SILENCE, 2.0), (R_RAMP, 1e-3), (R_SLOPE_RAMP, 1e-6), (R_OWNER, 7.0), (R_BEAT, 1.0)):
            nck.write_r(number, value, 0.05)
        nck.k0_mm[:], nck.slope[:] = [0.008, -0.003, 0.0005], [2e-6, -3e-6, 0.0]
        nck.table_weight[:] = [2e-3, -1e-3, 0.0, 4e-3, 0.0, 0.0]
    beats = {1.0: 2.0, 2.5: 3.0, 6.0: 4.0}  # the last one comes when the ramp has begun
    states = set()
    for number in range(1, 200):
        now = number * 0.1
        for nck in (real, meant):
            nck.advance(now)
            if now in beats:
                nck.write_r(R_BEAT, beats[now], now)
            if number == 100:
                nck.write_r(R_OWNER, 0.0, now)
        states.add(real.r[R_WATCH])
        assert real.k0_mm == pytest.approx(meant.k0_mm, abs=1e-3 * 3 * IPO_S), now
        assert real.slope == pytest.approx(meant.slope, abs=1e-6 * 3 * IPO_S), now
        assert real.table_weight == pytest.approx(meant.table_weight, abs=1e-3 * 3 * IPO_S), now
    assert states == {1.0, 2.0}
    assert max(map(abs, real.k0_mm)) < 1e-12
    steps = [
        abs(b - a)
        for one, two in itertools.pairwise(real.log)
        for a, b in zip(one.values_mm, two.values_mm, strict=True)
    ]
    assert max(steps[3:]) <= 1e-3 * IPO_S * (1 + 1e-9)


def test_a_ramp_of_zero_holds_and_power_on_begins_again() -> None:
    nck = control(START)
    for number, value in ((R_SILENCE, 1.0), (R_OWNER, 7.0), (R_BEAT, 1.0)):
        nck.write_r(number, value, 0.05)
    nck.write_k0(2, 0.004, 0.1)
    nck.advance(5.0)
    assert (nck.r[R_WATCH], nck.k0_mm[2]) == (2.0, 0.004)
    nck.power_on(6.0)
    nck.advance(7.0)
    assert (nck.r[R_WATCH], nck.k0_mm[2]) == (0.0, 0.0)
