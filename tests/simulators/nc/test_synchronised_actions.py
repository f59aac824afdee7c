"""The interpreter of synchronised actions; it runs the supplied watchdog, which is compared with its intended
behaviour."""

import itertools
from pathlib import Path

import numpy as np
import pytest

from simulators.nc import Activity, DayPart, LoadCase, MeanLoads, Nck
from simulators.nc.main_run import MainRun
from simulators.nc.nck import R_OFFSETS, R_REQUEST
from simulators.nc.synchronised import ProgramAlarm, SynchronisedActions, SystemVariable
from simulators.nc.watchdog import R_BEAT, R_ECHO, R_OWNER, R_RAMP, R_SILENCE, R_SLOPE_RAMP, R_WATCH
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


def test_a_number_that_is_defined_again_replaces_the_action_unless_it_is_protected() -> None:
    actions, r = channel("IDS=3 DO $R[0] = 1")
    actions.load("IDS=3 DO $R[0] = 2")
    actions.cycle()
    assert (r[0], actions.numbers) == (2.0, [3])
    actions.protected = range(3, 4)
    for block in ("ID=3 DO $R[0] = 3", "CANCEL(3)"):
        with pytest.raises(ProgramAlarm, match=r"line 1: IDS=3 is protected \(MD21240\)"):
            actions.load(block)
    actions.protected = range(0)
    actions.load("CANCEL(3)")
    assert actions.numbers == []


def test_reals_are_equal_within_their_precision() -> None:
    actions, r = channel("IDS=1 WHENEVER $R[1] == $R[2] DO $R[0] = 1\nIDS=2 WHENEVER $R[1] <> $R[2] DO $R[0] = 2")
    for other, expected in ((0.3, 1.0), (0.3 * (1 + 1e-9), 2.0)):
        r[1], r[2] = 0.1 + 0.2, other
        actions.cycle()
        assert r[0] == expected


def test_a_timer_stops_at_minus_one_and_keeps_what_it_has_counted() -> None:
    actions, r = channel("IDS=1 WHENEVER $R[1] <> 0 DO $AC_TIMER[1] = $R[1] $R[1] = 0\nIDS=2 DO $R[0] = $AC_TIMER[1]")
    for number, cycles in ((5.0, 100), (-1.0, 50)):
        r[1] = number
        for _ in range(cycles):
            actions.cycle()
    assert r[0] == pytest.approx(6.0)
    r[1] = 2.0
    actions.cycle()
    assert r[0] == pytest.approx(2.0)


def units(action: str, value: float) -> tuple[SynchronisedActions, list[float], list[float]]:
    r, k0 = [0.0] * 4, [value] * 3
    names = {"X": 0, "Y": 1, "Z": 2}
    variables = {"R": SystemVariable(r), "SA_TEMP_COMP_ABS_VALUE": SystemVariable(k0, names, "$$", lengths=range(3))}
    actions = SynchronisedActions(variables, [], IPO_S)
    actions.load(action)
    return actions, r, k0


def test_without_its_own_unit_an_action_reads_and_writes_lengths_in_that_of_the_running_program() -> None:
    text = "IDS=1 DO {}$R[0] = $$SA_TEMP_COMP_ABS_VALUE[X] $$SA_TEMP_COMP_ABS_VALUE[Y] = 2"
    for own, program, read, written in (
        ("", "G710", 25.4, 2.0), ("", "G700", 1.0, 50.8), ("G710 ", "G700", 25.4, 2.0), ("G700 ", "G710", 1.0, 50.8),
    ):  # fmt: skip
        actions, r, k0 = units(text.format(own), 25.4)
        actions.load(program)
        actions.cycle()
        assert (r[0], k0[1]) == pytest.approx((read, written))
    condition = "IDS=1 WHENEVER {}$$SA_TEMP_COMP_ABS_VALUE[X] > 2 DO $R[0] = 1"
    for own, met in (("", 0.0), ("G710 ", 1.0)):
        actions, r, _ = units(condition.format(own), 25.4)
        actions.load("G700")
        actions.cycle()
        assert r[0] == met


@pytest.mark.parametrize("keeps", [False, True])
def test_reset_ends_no_static_action_and_clears_the_parameters_in_dynamic_memory(keeps: bool) -> None:
    r = [0.0] * 4
    run = MainRun(["IDS=1 DO $AC_PARAM[1] = $AC_PARAM[1] + 1 $R[0] = $R[0] + 1 $R[1] = $AC_PARAM[1]"], r, {}, "XYZAC",
                  IPO_S, 0.0, keeps_parameters=keeps)  # fmt: skip
    for _ in range(3):
        run.cycle([0.0] * 5)
    run.reset()
    run.cycle([0.0] * 5)
    assert r[:2] == [4.0, 4.0 if keeps else 1.0]


def test_power_off_ends_the_actions_and_keeps_parameters_and_setting_data() -> None:
    nck = control(START)
    for number, value in ((R_SILENCE, 1.0), (R_RAMP, 1e-3), (R_OWNER, 7.0), (R_BEAT, 1.0)):
        nck.write_r(number, value, 0.05)
    nck.write_k0(2, 0.004, 0.1)
    nck.power_on(0.5, started=False)
    nck.advance(600.0)
    assert (nck.r[R_WATCH], nck.r[R_BEAT], nck.k0_mm[2]) == (1.0, 1.0, 0.004)


def compensated(*, inch: bool = False) -> Nck:
    """The supplied programs, a gateway that is alive until 0.9 s, and offsets."""
    nck = control(START, SLOPES)
    for number, value in ((R_SILENCE, 1.0), (R_RAMP, 1e-3), (R_SLOPE_RAMP, 1e-6), (R_OWNER, 7.0), (R_BEAT, 1.0)):
        nck.write_r(number, value, 0.05)
    nck.advance(0.5)
    assert nck.main_run is not None
    nck.main_run.actions.inch = inch
    for axis, value in enumerate((0.02, -0.004, 0.0005)):
        nck.write_k0(axis, value, 0.5)
    nck.slope[:], nck.r[R_OFFSETS] = [2e-6, -3e-6, 0.0], 0.003
    return nck


def left(nck: Nck) -> float:
    return max(map(abs, (*nck.k0_mm, *nck.slope, *nck.table_weight, *nck.r[R_OFFSETS : R_OFFSETS + 3])))


@pytest.mark.parametrize("event", ["reset", "end_program"])
def test_after_reset_and_at_the_end_of_a_program_silence_takes_everything_to_zero(event: str) -> None:
    nck = compensated()
    getattr(nck, event)(0.6)
    nck.advance(1.0)
    assert nck.r[R_WATCH] == 1.0
    assert nck.k0_mm == [0.02, -0.004, 0.0005]
    getattr(nck, event)(2.0)
    nck.advance(40.0)
    assert nck.r[R_WATCH] == 2.0
    assert left(nck) < 1e-12
    nck.write_r(R_BEAT, 2.0, 40.0)
    nck.advance(40.1)
    assert nck.r[R_WATCH] == 1.0


def test_in_an_inch_program_it_ramps_by_the_same_micrometres() -> None:
    nck = compensated(inch=True)
    nck.advance(11.05)
    assert nck.k0_mm[0] == pytest.approx(0.01, abs=1e-3 * 3 * IPO_S)
    steps = np.abs(np.diff([entry.values_mm for entry in nck.log[4:]], axis=0))
    assert steps.max() <= 1e-3 * IPO_S * (1 + 1e-9)


@pytest.mark.parametrize("number", [*range(60, 79, 3)])
def test_whichever_action_a_part_program_removes_the_beats_are_no_longer_copied_or_all_goes_to_zero(
    number: int,
) -> None:
    """The second is as good: a watchdog that ramps watches."""
    nck = compensated()
    assert nck.main_run is not None
    assert nck.main_run.actions.numbers == [*range(60, 79)]
    nck.main_run.actions.load(f"ID={number} DO $AC_PARAM[60] = 1")
    copied = []
    for beat in range(2, 8):
        nck.write_r(R_BEAT, float(beat), 0.2 * beat + 0.2)
        copied.append(nck.r[R_ECHO] == beat)
    nck.advance(60.0)
    assert not any(copied) or left(nck) < 1e-12


def test_the_slopes_program_must_be_there_while_a_gateway_has_slopes_ramped() -> None:
    for programs, ramp, copied in (((START,), 0.0, True), ((START,), 1e-6, False), ((START, SLOPES), 1e-6, True)):
        nck = control(*programs)
        for number, value in ((R_SILENCE, 1.0), (R_SLOPE_RAMP, ramp), (R_OWNER, 7.0), (R_BEAT, 1.0)):
            nck.write_r(number, value, 0.05)
        assert (nck.r[R_ECHO] == 1.0) is copied


def test_the_age_of_a_request_begins_with_each_number_and_outlasts_reset() -> None:
    nck = control(START)
    assert nck.main_run is not None
    nck.main_run.actions.load("IDS=99 DO $R[0] = $AC_TIMER[1]")

    def age(now_s: float) -> float:
        nck.advance(now_s)
        return nck.r[0]

    nck.write_r(R_REQUEST, 41.0, 1.0)
    assert age(8.0) == pytest.approx(7.0, abs=3 * IPO_S)
    nck.reset(8.0)
    assert age(9.0) == pytest.approx(8.0, abs=5 * IPO_S)
    nck.write_r(R_REQUEST, 42.0, 9.0)
    assert age(10.0) == pytest.approx(1.0, abs=3 * IPO_S)


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
