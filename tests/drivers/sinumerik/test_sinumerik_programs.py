"""The supplied NC programs use the parameters that the driver uses.

These tests read the programs. Their synchronised actions run in the tests of simulators/nc/synchronised.py, and the
probing cycle in test_sinumerik_cycle.py.
"""

import re
from pathlib import Path

import pytest

from drivers.nc import LINEAR_AXES
from drivers.sinumerik.settings import Handshake, LeaseParameters, OffsetRoute, SinumerikSettings
from gateway.config.sections import Probing
from simulators.nc import CycleSettings
from simulators.nc.main_run import MainRun
from simulators.nc.nck import CEC_TABLES

FOLDER = Path(__file__).parents[3] / "deploy" / "nc" / "sinumerik"
PROGRAMS = sorted(FOLDER.glob("*.SPF"))
HAND, LEASE = Handshake(), LeaseParameters()
SETTINGS = SinumerikSettings(security="none", url="opc.tcp://nc")


def statements(name: str) -> list[str]:
    """Lines without comments."""
    lines = (line.split(";")[0].strip() for line in (FOLDER / name).read_text().splitlines())
    return [line for line in lines if line]


def assigned(name: str) -> list[tuple[int, str]]:
    """R-parameter and what it is set to, in order."""
    found = (re.fullmatch(r"R(\d+) = (.+)", line) for line in statements(name))
    return [(int(match[1]), match[2]) for match in found if match]


def test_the_control_writes_its_own_parameters_only() -> None:
    own = {HAND.answers, HAND.state, HAND.reason, HAND.result_of, HAND.spread, HAND.version}
    for program in PROGRAMS:
        assert {number for number, _ in assigned(program.name)} <= own


def test_what_the_gateway_writes_is_what_the_program_reads() -> None:
    text = "\n".join(statements("TALC_SAFE_POINT.SPF"))
    for number in (HAND.request, HAND.withdraw, HAND.valid_for, HAND.dry_run):
        assert re.search(rf"\bR{number}\b", text)


def test_the_tables_rise_by_one_um_per_mm_and_join_the_pairs_that_the_emulated_control_has() -> None:
    values = dict(re.findall(r"^\$AN_CEC(\S+) = (\S+)$", (FOLDER / "TALC_CEC.INI").read_text(), re.MULTILINE))
    for table, (shifted, over) in enumerate(CEC_TABLES):
        assert values[f"_OUTPUT_AXIS[{table}]"] == f"(AX{shifted + 1})"
        assert values[f"_INPUT_AXIS[{table}]"] == f"(AX{over + 1})"
        low, high = float(values[f"_MIN[{table}]"]), float(values[f"_MAX[{table}]"])
        assert float(values[f"_STEP[{table}]"]) == high - low
        assert float(values[f"[{table},0]"]) == pytest.approx(low * 1e-3)
        assert float(values[f"[{table},1]"]) == pytest.approx(high * 1e-3)


def test_at_power_on_every_slope_and_weight_is_zero() -> None:
    """What becomes of them on silence: tests/simulators/nc/test_synchronised_actions.py."""
    text = "\n".join(statements("TALC_SLOPES.SPF"))
    slopes = [f"$SA_TEMP_COMP_SLOPE[{axis}]" for axis in LINEAR_AXES]
    for name in [*slopes, *(f"$SN_CEC_TABLE_WEIGHT[{table}]" for table in range(len(CEC_TABLES)))]:
        assert f"\n{name} = 0\n" in text


@pytest.mark.parametrize("name", ["TALC_START.SPF", "TALC_SLOPES.SPF"])
@pytest.mark.parametrize(
    ("setting", "value"),
    [("SA_TEMP_COMP_ABS_VALUE", -0.02), ("SA_TEMP_COMP_SLOPE", 2e-6), ("SN_CEC_TABLE_WEIGHT", 1e-3)],
)
def test_a_second_start_by_hand_does_nothing_while_something_is_in_force(name: str, setting: str, value: float) -> None:
    text = (FOLDER / name).read_text()
    own = (setting == "SA_TEMP_COMP_ABS_VALUE") == (name == "TALC_START.SPF")
    settings = {
        "SA_TEMP_COMP_ABS_VALUE": [0.0] * 3,
        "SA_TEMP_COMP_SLOPE": [0.0] * 3,
        "SN_CEC_TABLE_WEIGHT": [0.0] * len(CEC_TABLES),
    }
    settings[setting][2] = value
    marked = [0.0 if number in (90, 91, 92) else 1.0 for number in range(100)]
    r = list(marked)
    run = MainRun([text], r, settings, "XYZAC", 0.01, 0.0)
    assert settings[setting][2] == (0.0 if own else value), "at power on it goes"
    settings[setting][2], r[:] = value, marked
    if own:
        run.actions.load(text)
        assert (settings[setting][2], r) == (value, marked)
    else:
        run.actions.load(text)
        assert settings[setting][2] == value


def test_by_hand_nothing_happens_to_the_offsets_of_route_r_either() -> None:
    text = (FOLDER / "TALC_START.SPF").read_text()
    r = [0.0] * 100
    run = MainRun([text], r, {"SA_TEMP_COMP_ABS_VALUE": [0.0] * 3}, "XYZAC", 0.01, 0.0)
    for number in (90, 91, 92):
        r[number] = -0.01
        before = list(r)
        run.actions.load(text)
        assert r == before
        r[number] = 0.0


def test_no_synchronised_action_has_two_meanings() -> None:
    numbers = [n for p in PROGRAMS for line in statements(p.name) for n in re.findall(r"^IDS=(\d+) ", line)]
    assert len(numbers) == len(set(numbers)) == 19


REFERENCE = re.compile(r"(?<![A-Z$_\d])\$?R(?:(\d+)|\[(\d+)(?: \+ 3 \* TALC_POSE)?\])")
WRITTEN = re.compile(r"(?<![<>=(])(?<![A-Z$_\d])\$?R(?:(\d+)|\[(\d+)(?: \+ 3 \* TALC_POSE)?\]) = ")
"""An R-parameter on the left of an assignment, at the start of a line or after DO."""


def numbers(pattern: re.Pattern[str], program: Path) -> set[int]:
    """R-parameters that a program uses, or sets, results of all poses included."""
    found = {int(a or b) for line in statements(program.name) for a, b in pattern.findall(line)}
    firsts = {n for n in found if n in range(HAND.results, HAND.results + 3)}
    return found | {first + 3 * pose for first in firsts for pose in range(SETTINGS.poses)}


def test_programs_use_the_r_parameters_of_the_settings_and_no_others() -> None:
    meant = {number: name for name, number in SETTINGS.r_numbers()}
    offsets = SinumerikSettings(security="none", url="opc.tcp://nc", compensation=OffsetRoute(route="r"))
    meant |= {number: name for name, number in offsets.r_numbers()}
    used = set().union(*(numbers(REFERENCE, program) for program in PROGRAMS))
    assert used == set(meant), "R-parameters that one side knows and the other does not"


def test_what_the_gateway_writes_no_program_writes_but_at_power_on() -> None:
    gateways = {
        HAND.request,
        HAND.withdraw,
        HAND.valid_for,
        HAND.dry_run,
        LEASE.owner,
        LEASE.beat,
        LEASE.silence,
        LEASE.ramp,
    }
    gateways |= {LEASE.slope_ramp, *(OffsetRoute().first_r + i for i in range(3))}
    controls = {HAND.answers, HAND.state, HAND.reason, HAND.result_of, HAND.spread, HAND.version}
    controls |= {LEASE.state, LEASE.echo, LEASE.age}
    controls |= set(range(HAND.results, HAND.results + 3 * SETTINGS.poses))
    at_power_on = {"TALC_START.SPF", "TALC_SLOPES.SPF"}
    written = set()
    for program in PROGRAMS:
        sets = numbers(WRITTEN, program)
        written |= sets
        if program.name in at_power_on:
            assert sets <= gateways | controls
            reset = {n for line in statements(program.name) for n in re.findall(r"R\[(\d+)\] = 0", line)}
            assert {str(n) for n in sets & gateways} - {f"{HAND.withdraw}"} <= reset, "to zero and to nothing else"
        else:
            assert sets <= controls
    assert controls <= written


def test_poses_are_those_of_the_configuration_and_of_the_emulated_control() -> None:
    text = (FOLDER / "TALC_GUD.DEF").read_text()
    a, c = (
        [float(value) for value in re.search(rf"TALC_{axis}\[6\] = SET\(([^)]*)\)", text)[1].split(",")]  # type: ignore[index]
        for axis in "AC"
    )
    assert list(zip(a, c, strict=True)) == list(Probing().poses_deg) == list(CycleSettings().poses_deg)
