"""Route `errors`: the generated program as an interpreter runs it, beside the method's kinematics; and the driver."""

import math
from collections.abc import Iterator

import numpy as np
import pytest
from pydantic import ValidationError

from drivers.base import SetupError
from drivers.problems import settings_of
from drivers.sinumerik.programs import ErrorTerms, errors_program
from drivers.sinumerik.settings import Handshake, OffsetRoute, Paths, SinumerikSettings
from simulators.nc.synchronised import ProgramAlarm
from talc import kinematics
from talc.frame import FloatArray
from tests.benches.error_program import (
    BEAT,
    BOUND_UM,
    ECHO,
    IPO_S,
    OWNER,
    PROBED,
    PROBING,
    RADIUS_MM,
    SLEW_UM_PER_S,
    STATE,
    TERMS,
    TRAVEL,
    WARM,
    ErrorChannel,
    program,
    settings,
)
from tests.benches.waits import turns

REACH_M = (0.24, math.hypot(0.22, 0.27))
"""The reach of TRAVEL from the origin."""
LARGEST = kinematics.largest_offsets(REACH_M, RADIUS_MM * 1e-3)
SMALL = WARM / 8
"""What is reached in a few seconds."""
WIDE = (1e4, 1e4, 1e4)
AC_PARAMS = 35
"""$AC_PARAM[1] to [34] are in use: MD28254 has to be at least this."""


def random_positions(count: int, seed: int) -> Iterator[FloatArray]:
    """(5,) X Y Z A C within the travel, machine coordinates, mm and degrees."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        yield np.array(
            [*(rng.uniform(low, high) for low, high in TRAVEL), rng.uniform(-120, 120), rng.uniform(-400, 400)]
        )


def expected(channel: ErrorChannel, errors: FloatArray) -> FloatArray:
    return kinematics.tcp_offsets(errors, channel.tip(), RADIUS_MM * 1e-3)


def test_the_control_s_offsets_are_the_method_s_wherever_the_tool_is() -> None:
    channel, rng = ErrorChannel(program(bound_um=WIDE)), np.random.default_rng(1)
    channel.alive()
    for position in random_positions(40, 2):
        errors = rng.normal(0, 30, 9)
        channel.position = position
        channel.settle(errors)
        assert channel.shift_um == pytest.approx(expected(channel, errors), abs=1e-6)


def test_signs_are_those_of_the_configuration() -> None:
    text = errors_program(settings(signs=(1, -1, 1)), TERMS)
    channel = ErrorChannel(text)
    channel.alive()
    channel.settle(WARM)
    assert channel.shift_um * (-1, 1, -1) == pytest.approx(expected(channel, WARM), abs=1e-6)


def test_no_point_of_the_travel_moves_faster_than_the_slew_and_the_nine_keep_their_proportion() -> None:
    channel = ErrorChannel(program())
    channel.alive()
    channel.turn()
    channel.want(SMALL)
    before, cycles = channel.in_force, 0
    for _ in turns():
        channel.turn(25)
        moved = LARGEST @ np.abs(channel.in_force - before)
        assert moved.max() <= SLEW_UM_PER_S * 25 * IPO_S * (1 + 1e-9)
        assert np.ptp(channel.in_force / SMALL) < 1e-9
        before, cycles = channel.in_force, cycles + 25
        if np.abs(before - SMALL).max() <= 1e-9:
            break
    assert cycles * IPO_S == pytest.approx((LARGEST @ np.abs(SMALL)).max() / SLEW_UM_PER_S, abs=0.3), "and not slower"


@pytest.mark.parametrize("error", range(9))
def test_each_error_alone_moves_as_fast_as_the_slew_allows(error: int) -> None:
    channel, wanted = ErrorChannel(program()), 100.0 * np.eye(9)[error]
    channel.alive()
    channel.turn()
    channel.want(wanted)
    before = channel.in_force
    channel.turn(100)
    moved = LARGEST @ np.abs(channel.in_force - before)
    assert moved.max() == pytest.approx(SLEW_UM_PER_S * 100 * IPO_S, rel=0.02)


@pytest.mark.parametrize("error", [4, 5, 6, 7, 8])
def test_with_another_tool_in_use_nothing_moves_faster_either(error: int) -> None:
    """One that is 250 mm shorter than the origin's, as far out as it gets, with A turned from end to end."""
    channel = ErrorChannel(errors_program(settings().model_copy(update={"origin_tool_mm": 300.0}), TERMS))
    channel.run.tool(50.0)
    channel.alive()
    channel.turn()
    channel.want(100.0 * np.eye(9)[error])
    ways = []
    for a in np.linspace(-120.0, 120.0, 17):
        channel.position = np.array([*(high for _, high in TRAVEL), a, 0.0])
        shifts = channel.turn(11)
        ways.append(np.abs(shifts[-1] - shifts[0]).max())
    assert 0.75 < max(ways) / (SLEW_UM_PER_S * 10 * IPO_S) <= 1 + 1e-9


def test_a_late_or_absurd_write_makes_no_step() -> None:
    """Whatever arrives, and whenever: one cycle's slew at most, and what is not a number changes nothing."""
    channel = ErrorChannel(program())
    channel.alive()
    channel.settle(WARM)
    for absurd in (-WARM, WARM * 0, np.full(9, math.nan), np.full(9, math.inf), np.full(9, 1e300), np.full(9, -1e5)):
        before, in_force = channel.shift_um, channel.in_force
        channel.want(absurd)
        moved = np.abs(np.diff([before, *channel.turn(50)], axis=0))
        assert moved.max() <= SLEW_UM_PER_S * IPO_S * (1 + 1e-9)
        possible = np.abs(absurd).max() < 1e9  # NaN compares false
        assert np.isfinite(channel.in_force).all() if possible else np.array_equal(channel.in_force, in_force)
    one = WARM.copy()
    one[4] = math.nan
    before = channel.in_force
    channel.want(one)
    channel.turn(50)
    assert np.array_equal(channel.in_force, before)


def test_no_axis_goes_beyond_its_bound() -> None:
    channel = ErrorChannel(program())
    channel.alive()
    bounded = np.zeros(3, dtype=bool)
    for position in random_positions(40, 3):
        channel.position = position
        channel.settle(WARM * 4)
        want = expected(channel, WARM * 4)
        assert channel.shift_um == pytest.approx(np.clip(want, -np.array(BOUND_UM), BOUND_UM), abs=1e-6)
        bounded |= np.abs(want) > BOUND_UM
    assert bounded.all()


def test_while_the_control_probes_nothing_moves_and_afterwards_it_is_no_step() -> None:
    channel = ErrorChannel(program())
    channel.alive()
    channel.settle(SMALL)
    channel.r[PROBING] = 1.0
    for position in random_positions(20, 5):
        channel.position = position
        channel.turn()
        assert channel.shift_um == pytest.approx(expected(channel, SMALL), abs=1e-6), "on its way to the sphere"
    stood = channel.shift_um
    channel.r[PROBING] = 2.0
    channel.turn()
    assert channel.r[PROBED : PROBED + 3] == pytest.approx(stood * 1e-3)
    channel.want(-SMALL)
    for position in random_positions(20, 4):
        channel.position = position
        assert np.array_equal(channel.turn()[0], stood)
    channel.want(SMALL)
    channel.r[PROBING] = 3.0
    moved = np.abs(np.diff([stood, *channel.turn(4_000)], axis=0))
    assert moved.max() <= SLEW_UM_PER_S * IPO_S * (1 + 1e-9)
    assert channel.shift_um == pytest.approx(expected(channel, SMALL), abs=1e-6), "and it gets there"


@pytest.mark.slow
def test_errors_and_what_a_broken_off_cycle_has_left_move_within_the_slew_together() -> None:
    """Nothing of the shift that is taken back may come on top of what the errors move, at any point of the travel."""
    channel = ErrorChannel(program())
    channel.alive()
    channel.settle(SMALL)
    channel.r[PROBING] = 2.0
    channel.turn()
    channel.position = np.array([-150.0, 100.0, 250.0, -60.0, 0.0])
    channel.turn()
    stood = channel.shift_um
    channel.r[PROBING] = 5.0
    channel.want(-SMALL)
    assert np.abs(channel.turn() - stood).max() <= SLEW_UM_PER_S * IPO_S * (1 + 1e-9)
    left = channel.shift_um - expected(channel, channel.in_force)
    assert np.abs(left).max() > 1.0, "the shift of another place"
    errors, both = channel.in_force, 0
    for _ in turns():
        channel.turn()
        left_now = channel.shift_um - expected(channel, channel.in_force)
        moved = LARGEST @ np.abs(channel.in_force - errors)
        assert (moved.max() + np.abs(left_now - left).max()) <= SLEW_UM_PER_S * IPO_S * (1 + 1e-6)
        both += bool(moved.any())
        left, errors = left_now, channel.in_force
        if np.abs(left).max() <= 1e-6:
            break
    assert both > 50, "both have moved"
    channel.turn(6_000)
    assert channel.shift_um == pytest.approx(expected(channel, -SMALL), abs=1e-6)


def test_a_cycle_that_no_gateway_compensates_is_not_reported_with_an_earlier_one_s_shift() -> None:
    channel = ErrorChannel(program())
    channel.alive()
    channel.settle(SMALL)
    channel.r[PROBING] = 2.0
    channel.turn(10)
    channel.r[PROBING] = 3.0
    assert channel.r[PROBED : PROBED + 3] == pytest.approx(channel.shift_um * 1e-3)
    assert any(channel.shift_um)
    channel.r[OWNER] = 0.0  # now the gateway only monitors
    channel.turn(4_000)
    assert channel.shift_um == pytest.approx(np.zeros(3), abs=1e-9)
    channel.r[PROBING] = 2.0
    channel.turn(10)
    channel.r[PROBING] = 3.0
    assert channel.r[PROBED : PROBED + 3] == pytest.approx([0.0] * 3, abs=1e-12)


@pytest.mark.parametrize("ramp_um_per_s", [0.5, 30.0])
def test_on_silence_the_errors_go_to_zero_no_faster_than_the_ramp_and_the_slew(ramp_um_per_s: float) -> None:
    channel = ErrorChannel(program())
    channel.alive(ramp_um_per_s, silence_s=2.0)
    channel.settle(SMALL)
    stood = channel.shift_um
    assert channel.turn(195)[-1] == pytest.approx(stood)
    rate = min(ramp_um_per_s, SLEW_UM_PER_S)
    before = channel.in_force
    assert np.abs(np.diff(channel.turn(100), axis=0)).max() <= rate * IPO_S * (1 + 1e-9)
    moved = LARGEST @ np.abs(channel.in_force - before)
    assert moved.max() <= rate * 100 * IPO_S * (1 + 1e-9), "at no point of the travel"
    assert channel.r[STATE] == 2.0
    assert channel.shift_um != pytest.approx(stood)
    channel.want(WARM)  # a write that arrives now
    channel.turn()
    channel.beat()  # and then the gateway again: what it had wanted has been forgotten
    channel.turn(int((LARGEST @ np.abs(SMALL)).max() / rate / IPO_S))
    assert channel.in_force == pytest.approx(0.0, abs=1e-9)


def test_a_ramp_of_zero_holds_what_is_in_force_also_against_a_late_write() -> None:
    channel = ErrorChannel(program())
    channel.alive(0.0, silence_s=1.0)
    channel.settle(WARM)
    channel.turn(150)
    channel.want(-WARM)
    channel.turn(50)
    assert np.array_equal(channel.in_force, WARM)


def test_a_gateway_that_leaves_and_none_at_all_leave_nothing_in_force() -> None:
    channel = ErrorChannel(program())
    channel.want(WARM)
    channel.turn(50)
    assert np.array_equal(channel.shift_um, np.zeros(3)), "nobody has claimed the control"
    channel.beat()
    channel.turn()
    assert channel.r[STATE] == 0.0, "nor does a beat without an owner"
    channel = ErrorChannel(program())
    channel.alive()
    channel.settle(WARM * 0.01)
    channel.r[OWNER] = 0.0
    channel.turn(200)
    assert channel.shift_um == pytest.approx(np.zeros(3), abs=1e-9)


def test_a_second_start_by_hand_does_nothing_while_something_is_in_force() -> None:
    channel = ErrorChannel(program())
    channel.alive()
    channel.settle(SMALL)
    before, r = channel.shift_um, list(channel.r)
    channel.call(program(bound_um=WIDE))
    assert channel.r == r
    assert np.abs(channel.turn(50) - before).max() == 0.0
    channel.r[OWNER] = 0.0
    channel.turn(4_000)
    assert channel.shift_um == pytest.approx(np.zeros(3), abs=1e-9)
    channel.call(program())
    assert not any(channel.turn(50).ravel())
    channel.protected = range(60, 110)
    with pytest.raises(ProgramAlarm, match="IDS=60 is protected"):
        channel.call(program())


def test_the_echo_shows_that_the_whole_program_runs() -> None:
    channel = ErrorChannel(program())
    channel.alive()
    assert channel.r[ECHO] == 0.0
    channel.turn()
    assert channel.r[ECHO] == 1.0


@pytest.mark.slow
def test_a_reset_at_any_moment_makes_no_step_and_the_program_goes_on() -> None:
    """Also within a cycle, where the offsets of another place are held."""
    channel = ErrorChannel(program())
    channel.alive(silence_s=30.0)
    channel.settle(SMALL)
    channel.r[PROBING] = 2.0
    channel.turn(3)
    channel.position = np.array([-150.0, 100.0, 250.0, -60.0, 0.0])
    channel.turn(3)
    stood = channel.shift_um
    assert np.abs(stood - expected(channel, SMALL)).max() > 1.0, "the shift of another place"
    shifts = [stood]
    for _ in range(3):
        channel.run.reset()
        shifts.extend(channel.turn(50))
    assert np.ptp(shifts, axis=0).max() == 0.0, "it goes on holding"
    channel.run.reset()
    channel.r[PROBING] = 5.0
    shifts.extend(channel.turn(500))
    channel.run.reset()
    shifts.extend(channel.turn(12_000))
    assert np.abs(np.diff(shifts, axis=0)).max() <= SLEW_UM_PER_S * IPO_S * (1 + 1e-9)
    assert channel.r[STATE] == 2.0
    assert channel.shift_um == pytest.approx(np.zeros(3), abs=1e-9), "silence, after resets"


def test_in_an_inch_program_the_offsets_are_the_same_micrometres() -> None:
    channel = ErrorChannel(program())
    channel.run.actions.inch = True
    channel.alive()
    channel.settle(WARM)
    assert channel.shift_um == pytest.approx(expected(channel, WARM), abs=1e-6)


TOOL = 135
TOOL_NODE = "/Channel/State/actToolLength1[u1]"


def test_the_length_of_the_tool_counts_and_its_change_is_a_ramp() -> None:
    """A = 90 degrees: 100 mm more of tool turn into 100 mm along Y of the table."""
    with_tool = settings().model_copy(update={"nodes": Paths(tool_length=TOOL_NODE)})
    channel = ErrorChannel(errors_program(with_tool, TERMS))
    channel.position[3] = 90.0
    channel.alive()
    channel.settle(WARM)
    assert channel.shift_um == pytest.approx(expected(channel, WARM), abs=1e-6)
    shifts, before = [channel.shift_um], channel.shift_um
    for longer, turns_ in ((100.0, 3_000), (math.nan, 50), (1e4, 50)):
        channel.r[TOOL] = longer
        shifts.extend(channel.turn(turns_))
        tip = channel.tip() - [0.0, 0.0, 100.0, 0.0, 0.0]
        assert channel.shift_um == pytest.approx(kinematics.tcp_offsets(WARM, tip, RADIUS_MM * 1e-3), abs=1e-6)
    assert np.abs(channel.shift_um - before).max() > 2.0
    assert np.abs(np.diff(shifts, axis=0)).max() <= SLEW_UM_PER_S * IPO_S / 2 * (1 + 1e-6)


@pytest.mark.parametrize("origin_tool_mm", [0.0, 60.0, -5.0])
def test_a_longer_tool_is_right_without_any_setting_and_its_change_is_a_ramp(origin_tool_mm: float) -> None:
    """A = 90 degrees, also in an inch program; between two tools none is in force."""
    channel = ErrorChannel(errors_program(settings().model_copy(update={"origin_tool_mm": origin_tool_mm}), TERMS))
    channel.position[3] = 90.0
    channel.run.actions.inch = True
    channel.run.tool(origin_tool_mm)
    channel.alive()
    channel.settle(WARM)
    assert channel.shift_um == pytest.approx(expected(channel, WARM), abs=1e-6)
    shifts, before = [channel.shift_um], channel.shift_um
    for length, cycles in ((0.0, 50), (origin_tool_mm + 100.0, 3_000), (0.0, 50), (origin_tool_mm + 400.0, 50)):
        channel.run.tool(length)
        shifts.extend(channel.turn(cycles))
    tip = channel.tip() - [0.0, 0.0, 100.0, 0.0, 0.0]
    assert channel.shift_um == pytest.approx(kinematics.tcp_offsets(WARM, tip, RADIUS_MM * 1e-3), abs=1e-6)
    assert np.abs(channel.shift_um - before).max() > 2.0
    assert np.abs(np.diff(shifts, axis=0)).max() <= SLEW_UM_PER_S * IPO_S / 2 * (1 + 1e-6)
    channel.beat()
    channel.turn(2)
    assert channel.r[ECHO] != channel.r[BEAT], "no tool is so long: no beat, so nothing is written any more"


def test_both_axes_of_a_gantry_get_the_same_offset_in_the_same_cycle() -> None:
    route = settings().compensation.model_copy(update={"synchronised": {"X": "C"}})
    text = errors_program(settings().model_copy(update={"compensation": route}), TERMS)
    assert text.count("$SA_TEMP_COMP_ABS_VALUE[C] = 0\n") == 1
    channel = ErrorChannel(text)
    channel.alive()
    channel.settle(WARM)
    for _ in range(20):
        channel.want(-WARM)
        channel.turn()
        assert channel.k0_mm[4] == channel.k0_mm[0] != 0.0


@pytest.mark.parametrize("number", range(60, 102, 4))
def test_whichever_action_is_removed_no_beat_is_copied_or_silence_still_takes_all_to_zero(number: int) -> None:
    channel = ErrorChannel(program())
    channel.alive(silence_s=2.0)
    channel.settle(SMALL)
    channel.turn(3)
    channel.run.actions.load(f"ID={number} DO $R[0] = 1")
    copied = 0
    for _ in range(5):
        channel.beat()
        channel.turn(2)
        copied += channel.r[ECHO] == channel.r[BEAT]
    channel.turn(4_000)
    assert copied == 0 or channel.shift_um == pytest.approx(np.zeros(3), abs=1e-9)


def test_the_program_is_within_the_limits_that_its_page_names() -> None:
    text = program(slew_um_per_s=1e-5)
    lines = text.splitlines()
    numbers = [int(line[4 : line.index(" ")]) for line in lines if line.startswith("IDS=")]
    assert numbers == list(range(60, 60 + len(numbers)))
    assert len(numbers) == 42
    assert max(map(len, lines)) <= 512
    assert "E-" not in text, "an exponent is written otherwise on the control"
    assert all(f"$AC_PARAM[{number}]" in text for number in range(1, AC_PARAMS))
    assert f"$AC_PARAM[{AC_PARAMS}]" not in text
    assert "HAS NOT RUN ON A REAL CONTROL" in text
    assert text.isascii()


@pytest.mark.parametrize(
    ("route", "field", "code"),
    [
        ({"route": "errors"}, "travel_mm", "sinumerik_travel_missing"),
        ({"route": "errors", "travel_mm": TRAVEL, "tables": {"XY": 0}}, "tables", "sinumerik_no_tables"),
        (
            {"route": "errors", "travel_mm": TRAVEL, "axis_names": {"X": "X", "Y": "Y", "Z": "Z"}},
            "axis_names",
            "sinumerik_axis_names",
        ),
        (
            {"route": "errors", "travel_mm": TRAVEL, "axis_names": {"X": "X1", "Y": "Y1", "Z": "Z] = 9", "A": "A1"}},
            "axis_names",
            "sinumerik_axis_name",
        ),
        ({"route": "k0", "synchronised": {"X": "X2"}}, "synchronised", "sinumerik_gantry"),
        (
            {"route": "errors", "travel_mm": TRAVEL, "synchronised": {"C": "C2"}},
            "synchronised",
            "sinumerik_synchronised",
        ),
        (
            {"route": "errors", "travel_mm": TRAVEL, "synchronised": {"X": "Y"}},
            "synchronised",
            "sinumerik_synchronised",
        ),
        ({"route": "errors", "travel_mm": TRAVEL, "synchronised": {"X": "X 2"}}, "synchronised", "sinumerik_axis_name"),
    ],
)
def test_invalid_settings_are_refused(route: dict[str, object], field: str, code: str) -> None:
    with pytest.raises(SetupError) as caught:
        settings_of(OffsetRoute, route)
    assert caught.value.field[0] == field
    assert caught.value.what.says(code)


def test_without_the_length_of_the_origin_s_tool_nothing_is_computed() -> None:
    with pytest.raises(SetupError) as caught:
        settings_of(SinumerikSettings, {**dict(settings()), "origin_tool_mm": None})
    assert caught.value.field == ("origin_tool_mm",)
    assert caught.value.what.says("sinumerik_no_origin_tool")


def test_no_r_parameter_has_two_meanings_and_another_route_needs_no_program() -> None:
    with pytest.raises(ValidationError, match=r"R100 is .*as well as errors\.wanted"):
        settings().model_validate({**dict(settings()), "handshake": Handshake(spread=100)})
    with pytest.raises(SetupError) as caught:
        errors_program(SinumerikSettings(security="none", url="opc.tcp://nc"), ErrorTerms(1.0, 120.0, BOUND_UM))
    assert caught.value.what.says("sinumerik_no_program")
