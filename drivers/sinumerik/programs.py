"""The NC program with which the control computes the offsets from nine errors, for one machine's data.

It consists of synchronised actions. They contain only what NC Programming, Programming Manual, 12/2019
(6FC5398-2EP40-0BA0), 2.15.7, lists for them: SIN and COS of degrees and ABS, but no MINVAL, and comparisons in
parentheses, because AND and OR bind tighter. The smaller of a and b is 0.5 * (a + b - ABS(a - b)); a value within plus
and minus b is 0.5 * (ABS(a + b) - ABS(a - b)); TRUNC(1 / (1 + ABS(a - b))) is 1 where two whole numbers are equal,
otherwise 0.

What must outlast a cycle is in R-parameters and in SD43900 itself: RESET sets $AC_PARAM to 0. Each beat walks through
all actions: those without which the watchdog would not do its work add 1 to $AC_PARAM[1], and the last one copies the
beat only if none is missing. A gateway whose beat is not copied writes nothing.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from drivers.base import SetupError
from drivers.nc import ERRORS, LINEAR_AXES, Triple
from drivers.sinumerik.settings import ERROR_STATES, SinumerikSettings, error_reach_mm
from drivers.text import Text

PROGRAM_VERSION: Final = 3
"""Version of the program and of the meaning of its parameters; the control shows it while the program is active."""
FIRST_ID: Final = 60
"""ID of the first static synchronised action; the others follow it."""
_IMPLAUSIBLE_UM: Final = 1_000_000
"""What would move the tool by a metre is an invalid number: nothing moves."""
_GONE_MM: Final = 0.00005
"""Offsets that together are less may go to zero at once."""
_TINY_UM: Final = 1e-9
_COUNTS: Final = 26
"""First of nine $AC_PARAM: the errors that count."""
_LONG_AGO_S: Final = 1_000_000
_COUNT: Final = " $AC_PARAM[1] = $AC_PARAM[1] + 1"
EY0A, EZ0A, EX0C, EY0C, EZ0T, ER0T, EA0C, EB0C, EC0C = range(ERRORS)


@dataclass(frozen=True, slots=True)
class ErrorTerms:
    """What the program keeps to, whatever a gateway writes."""

    slew_um_per_s: float
    radius_mm: float
    """Radius at which ER0T is."""
    bound_um: Triple


def errors_program(settings: SinumerikSettings, terms: ErrorTerms) -> str:
    """The text of TALC_ERRORS.SPF. Raises SetupError for settings of another route."""
    if settings.compensation.route != "errors":
        raise SetupError(
            Text("sinumerik_no_program", route=settings.compensation.route), field=("compensation", "route")
        )
    lines, actions = [*_start(settings, terms)], [*_actions(settings, terms)]
    counted = sum(action.endswith(_COUNT) for action in actions) - ERRORS // 3  # three run on silence, or three others
    for number, action in enumerate([*actions, _echo(settings, counted)], FIRST_ID):
        lines.append(f"IDS={number} {action}")
    lines += ["STOPRE", f"R[{settings.errors.version}] = {PROGRAM_VERSION}", "M17"]
    return "\n".join(lines) + "\n"


def _start(settings: SinumerikSettings, terms: ErrorTerms) -> Iterator[str]:
    lease, errors, comp, hand = settings.lease, settings.errors, settings.compensation, settings.handshake
    along, across = error_reach_mm(settings)
    yield "; Offsets of X, Y, Z from nine thermal errors and from where the tool is, in each interpolation cycle."
    yield "; Written by talc-gateway nc sinumerik-files: do not change it here. HAS NOT RUN ON A REAL CONTROL."
    yield "; Call after power on instead of TALC_START, with the axes at rest. Parameters: docs/nc.md, Nine errors."
    yield "PROC TALC_ERRORS SAVE DISPLOF"
    yield "G710"
    yield "; By hand only while nothing is in force: what goes to zero here would be a step."
    yield "STOPRE"
    names = [name for axis in range(3) for name in comp.moved_together(axis)]
    in_force = " + ".join(f"ABS($SA_TEMP_COMP_ABS_VALUE[{name}])" for name in names)
    yield f"IF ($P_PROG_EVENT <> 4) AND ({in_force} > {_nc_number(_GONE_MM)})"
    yield '  MSG("TALC_ERRORS: offsets are in force. Stop the gateway, wait until they are 0, call it again")'
    yield from ("  M0", "  M17", "ENDIF")
    for name in names:
        yield f"$SA_TEMP_COMP_ABS_VALUE[{name}] = 0"
    for number in (lease.owner, lease.silence, lease.state, lease.ramp, errors.version, errors.tool):
        yield f"R[{number}] = 0"
    for first, count in (
        (errors.wanted, ERRORS), (errors.in_force, ERRORS), (errors.probed, 3), (errors.kept, ERROR_STATES)
    ):  # fmt: skip
        yield " ".join(f"R[{first + i}] = 0" for i in range(count))
    told = (terms.slew_um_per_s, terms.radius_mm, *terms.bound_um, along, across)
    yield " ".join(f"R[{errors.terms + i}] = {_nc_number(value)}" for i, value in enumerate(told))
    yield f"R[{errors.tool_range}] = {'-' * settings.reads_its_tool}{_nc_number(settings.tool_range_mm)}"
    yield f"R[{errors.echo}] = R[{lease.beat}] R[{lease.age}] = {_LONG_AGO_S}"
    yield f"R[{hand.version}] = 0"  # shown again by the first call of TALC_SAFE_POINT
    yield f"R[{hand.withdraw}] = R[{hand.request}]"  # one from before power off, whose age is not known
    yield "TALC_RESET"


def _actions(settings: SinumerikSettings, terms: ErrorTerms) -> Iterator[str]:
    """In the order in which a cycle runs them; the last one is missing."""
    yield from _watchdog(settings)
    yield from _hold(settings)
    yield from _slew(settings, terms)
    yield from _geometry(settings, terms)
    yield from _output(settings, terms)


def _walks(settings: SinumerikSettings) -> str:
    """A new beat has not passed through all actions yet."""
    return f"({_r(settings.lease.beat)} <> {_r(settings.errors.echo)})"


def _echo(settings: SinumerikSettings, counted: int) -> str:
    """The last action. counted: how many of them count"""
    lease = settings.lease
    owned = f"({_r(lease.owner)} > 0) AND ($AC_PARAM[1] == {counted})"
    return (
        f"WHENEVER {_walks(settings)} AND {owned} DO {_r(settings.errors.echo)} = {_r(lease.beat)} {_r(lease.age)} = 0"
    )


def _watchdog(settings: SinumerikSettings) -> Iterator[str]:
    """As in TALC_START, but on silence the wanted errors are zero, and the slew takes them there: $AC_PARAM[2] is 1
    while a gateway is alive, $AC_PARAM[26] to [34] are the errors that count."""
    hand, lease, first = settings.handshake, settings.lease, settings.errors.wanted
    owner, age, silence, state, ramp = (_r(n) for n in (lease.owner, lease.age, lease.silence, lease.state, lease.ramp))
    asked, seen, alive, three = _r(hand.request), "$AC_PARAM[3]", "$AC_PARAM[2]", range(3)
    none = " ".join(f"$AC_PARAM[{_COUNTS + i}] = 0" for i in range(ERRORS))
    fresh = f"$AC_PARAM[1] = 0 {alive} = 0 $AC_PARAM[7] = 0 $AC_PARAM[24] = 0"
    yield f"DO {fresh} {age} = {age} + $MN_IPO_CYCLE_TIME {none}{_COUNT}"
    yield f"WHENEVER ({age} <= {silence}) AND ({owner} > 0) DO {alive} = 1"
    yield f"DO {state} = (2 - {alive}) * {_within(f'{state} + {alive}', '1')}{_COUNT}"
    for i in range(0, ERRORS, 3):
        zero = " ".join(f"{_r(first + i + k)} = 0" for k in three)
        yield f"WHENEVER ({state} == 2) AND ({ramp} > 0) DO {zero}{_COUNT}"
    for i in range(0, ERRORS, 3):
        wanted = " ".join(f"$AC_PARAM[{_COUNTS + i + k}] = {_r(first + i + k)}" for k in three)
        yield f"WHENEVER ({state} <> 2) OR ({ramp} <= 0) DO {wanted}{_COUNT}"
    same = f"TRUNC(1 / (1 + ABS(({asked} + 1 - {seen}) * {seen})))"
    yield (
        f"WHENEVER ({asked} + 1 <> {seen}) OR {_walks(settings)} DO $AC_TIMER[1] = $AC_TIMER[1] * {same}"
        f" {seen} = {asked} + 1{_COUNT}"
    )


def _hold(settings: SinumerikSettings) -> Iterator[str]:
    """$AC_PARAM[8]: nothing moves from the first touch to the last while a gateway is alive. Both ends are at the same
    place, so that there is nothing to take back afterwards. $AC_PARAM[21] to [23] are the offsets in force, mm; held,
    they are reported."""
    comp, first = settings.compensation, settings.errors.probed
    touches = f"TRUNC(1 / (1 + ABS({_r(settings.handshake.state)} - 2)))"
    out = " ".join(
        f"$AC_PARAM[{21 + i}] = {_minus(comp.sign(i))}$$SA_TEMP_COMP_ABS_VALUE[{comp.axis_names[axis]}]"
        for i, axis in enumerate(LINEAR_AXES)
    )
    yield f"DO G710 {out}{_COUNT}"
    told = " ".join(
        f"{_r(first + i)} = {_r(first + i)} + $AC_PARAM[9] * ($AC_PARAM[{21 + i}] - {_r(first + i)})" for i in range(3)
    )
    yield (
        f"DO $AC_PARAM[9] = {touches} $AC_PARAM[8] = $AC_PARAM[9] * $AC_PARAM[2]"
        f" $AC_PARAM[9] = $AC_PARAM[9] * (1 - {_held(settings)}) {told}{_COUNT}"
    )


def _slew(settings: SinumerikSettings, terms: ErrorTerms) -> Iterator[str]:
    """The errors in force move in proportion, so far that no point of the travel moves faster than the slew. What is
    not a number moves nothing, and counts as a missing beat."""
    slew, ramp = _nc_number(terms.slew_um_per_s), f"1000 * {_r(settings.lease.ramp)}"
    wanted = [f"$AC_PARAM[{_COUNTS + i}]" for i in range(ERRORS)]
    force = [_r(settings.errors.in_force + i) for i in range(ERRORS)]
    way = [f"ABS({w} - {e})" for w, e in zip(wanted, force, strict=True)]
    along_mm, across_mm = error_reach_mm(settings)
    along, across = _nc_number(along_mm * 1e-3), _nc_number(across_mm * 1e-3)
    grown = [_nc_number(reach / terms.radius_mm) for reach in (along_mm, across_mm)]
    if settings.reads_its_tool:
        longer = f"ABS({_r(_tool_kept(settings))})"
        across = f"({across} + 0.001 * {longer})"
        grown[1] = f"({grown[1]} + {_nc_number(1.0 / terms.radius_mm)} * {longer})"
    silent = f"0.5 * ({slew} + {ramp} - ABS({slew} - {ramp}))"
    bridged = " + ".join(f"ABS({bridge})" for bridge in _bridge(settings))
    yield (
        f"DO $AC_PARAM[4] = ($AC_PARAM[2] * {slew} + (1 - $AC_PARAM[2]) * {silent}) * $MN_IPO_CYCLE_TIME"
        f" $AC_PARAM[25] = 0.5 * {slew} * $MN_IPO_CYCLE_TIME"
        f" $AC_PARAM[9] = TRUNC(1000000 * ({bridged}))"
        f" $AC_PARAM[4] = $AC_PARAM[4] * (1 - 0.5 * {_within('$AC_PARAM[9]', '1')}){_COUNT}"
    )
    yield f"DO $AC_PARAM[5] = {way[EX0C]} + {grown[0]} * {way[ER0T]} + {across} * ({way[EB0C]} + {way[EC0C]}){_COUNT}"
    yield (
        f"DO $AC_PARAM[6] = {way[EY0C]} + {way[EZ0T]} + {grown[1]} * {way[ER0T]} + {across} * {way[EA0C]}"
        f" + {along} * ({way[EB0C]} + {way[EC0C]}){_COUNT}"
    )
    higher = f"0.5 * ({way[EY0A]} + {way[EZ0A]} + ABS({way[EY0A]} - {way[EZ0A]}))"
    yield f"DO $AC_PARAM[6] = $AC_PARAM[6] + {higher}{_COUNT}"
    yield f"DO $AC_PARAM[5] = 0.5 * ($AC_PARAM[5] + $AC_PARAM[6] + ABS($AC_PARAM[5] - $AC_PARAM[6])){_COUNT}"
    possible = f"WHENEVER $AC_PARAM[5] < {_IMPLAUSIBLE_UM} DO"
    part = _within(f"$AC_PARAM[4] / ($AC_PARAM[5] + {_nc_number(_TINY_UM)})", "1")
    yield f"{possible} $AC_PARAM[7] = (1 - $AC_PARAM[8]) * {part}{_COUNT}"
    for first in range(0, ERRORS, 3):
        moved = (
            f"{force[i]} = {force[i]} + $AC_PARAM[7] * ({wanted[i]} - {force[i]})" for i in range(first, first + 3)
        )
        yield f"{possible} {' '.join(moved)}{_COUNT}"


def _geometry(settings: SinumerikSettings, terms: ErrorTerms) -> Iterator[str]:
    """The shift of the tool at the present position, µm, in $AC_PARAM[16], [19] and [20]: talc.kinematics. The tool is
    as long as $AC_ACT_ORI_TOOL_LENGTH says, with the opposite sign and along Z, or as the gateway says; $AC_PARAM[24]
    is the change of its length. While no length is in force (D0), the last one counts."""
    names = settings.compensation.axis_names
    e = [_r(settings.errors.in_force + i) for i in range(ERRORS)]
    x, y, z = (
        _less(f"$AA_IM[{names[axis]}]", zero) for axis, zero in zip(LINEAR_AXES, settings.origin_mm, strict=True)
    )
    told, kept = _r(settings.errors.tool), _r(_tool_kept(settings))
    z = f"({z} - {kept})"
    a, c, s = f"$AA_IM[{names['A']}]", "$AC_PARAM[10]", "$AC_PARAM[11]"
    px, py, pz, grown = (f"$AC_PARAM[{number}]" for number in (12, 13, 14, 15))
    if settings.reads_its_tool:
        longer = _less("(0 - $AC_ACT_ORI_TOOL_LENGTH[3])", settings.origin_tool_mm or 0.0)
        none = "TRUNC(1 / (1 + 1000000 * ABS($AC_ACT_ORI_TOOL_LENGTH[3])))"
        yield f"DO G710 {told} = {told} + (1 - {none}) * ({longer} - {told}){_COUNT}"
    changed = f"$AC_PARAM[24] = {told} - {kept} {kept} = {told}"
    yield f"WHENEVER ABS({told}) <= {_nc_number(settings.tool_range_mm)} DO {changed}{_COUNT}"
    yield f"DO G710 {c} = COS({a}) {s} = SIN({a}) {px} = 0.001 * {x}{_COUNT}"
    yield f"DO G710 {py} = 0.001 * ({c} * {y} + {s} * {z}) {pz} = 0.001 * ({c} * {z} - {s} * {y}){_COUNT}"
    yield f"DO {grown} = {_nc_number(1000.0 / terms.radius_mm)} * {e[ER0T]}{_COUNT}"
    yield f"DO $AC_PARAM[16] = {e[EX0C]} + {grown} * {px} + {e[EB0C]} * {pz} - {e[EC0C]} * {py}{_COUNT}"
    yield f"DO $AC_PARAM[17] = {e[EY0C]} + {grown} * {py} - {e[EA0C]} * {pz} + {e[EC0C]} * {px}{_COUNT}"
    yield f"DO $AC_PARAM[18] = {e[EZ0T]} + {e[EA0C]} * {py} - {e[EB0C]} * {px}{_COUNT}"
    yield f"DO $AC_PARAM[19] = {e[EY0A]} + {c} * $AC_PARAM[17] - {s} * $AC_PARAM[18]{_COUNT}"
    yield f"DO $AC_PARAM[20] = {e[EZ0A]} + {s} * $AC_PARAM[17] + {c} * $AC_PARAM[18]{_COUNT}"


def _output(settings: SinumerikSettings, terms: ErrorTerms) -> Iterator[str]:
    """Within the bound, to K0. What would be a step after a cycle or at a change of the tool goes into a bridge, which
    the slew takes back."""
    comp = settings.compensation
    target = [f"$AC_PARAM[{number}]" for number in (16, 19, 20)]
    out, bridge = [f"$AC_PARAM[{21 + axis}]" for axis in range(3)], _bridge(settings)
    bounds = [_nc_number(bound) for bound in terms.bound_um]
    free, each = "(1 - $AC_PARAM[8])", range(3)
    yield "DO " + " ".join(f"{target[i]} = {_within(target[i], bounds[i])}" for i in each) + _COUNT
    same_tool = "TRUNC(1 / (1 + 1000000 * ABS($AC_PARAM[24])))"
    yield (
        f"DO $AC_PARAM[9] = 1 - (1 - {_held(settings)} * {free}) * {same_tool} "
        + " ".join(
            f"{bridge[i]} = {bridge[i]} + $AC_PARAM[9] * (1000 * {out[i]} - {target[i]} - {bridge[i]})" for i in each
        )
        + _COUNT
    )
    decay = " ".join(f"{bridge[i]} = {bridge[i]} - {free} * {_within(bridge[i], '$AC_PARAM[25]')}" for i in each)
    yield f"DO {decay}{_COUNT}"
    for i in each:
        yield (
            f"DO {out[i]} = {out[i]} + {free} * (0.001 * {_within(f'{target[i]} + {bridge[i]}', bounds[i])} - {out[i]})"
            f"{_COUNT}"
        )
    for i in each:
        for name in comp.moved_together(i):
            k0 = f"$$SA_TEMP_COMP_ABS_VALUE[{name}] = {_minus(comp.sign(i))}{out[i]}"
            yield f"WHENEVER ($AC_PARAM[8] == 0) OR {_walks(settings)} DO G710 {k0}{_COUNT}"
    yield f"DO {_held(settings)} = $AC_PARAM[8]{_COUNT}"


def _bridge(settings: SinumerikSettings) -> list[str]:
    """What remains of a step, µm, of each axis."""
    return [_r(settings.errors.kept + axis) for axis in range(3)]


def _held(settings: SinumerikSettings) -> str:
    """Whether the offsets were held in the cycle before."""
    return _r(settings.errors.kept + 3)


def _tool_kept(settings: SinumerikSettings) -> int:
    """R-parameter of the tool that the offsets in force are for."""
    return settings.errors.kept + 4


def _minus(sign: int) -> str:
    return "0 - " if sign < 0 else ""


def _r(number: int) -> str:
    return f"$R[{number}]"


def _nc_number(value: float) -> str:
    """Without an exponent, which is written differently there."""
    text = f"{value:.9f}".rstrip("0")
    return text + "0" if text.endswith(".") else text


def _less(term: str, value: float) -> str:
    return f"({term} {'-' if value >= 0 else '+'} {_nc_number(abs(value))})"


def _within(value: str, most: str) -> str:
    return f"0.5 * (ABS({value} + {most}) - ABS({value} - {most}))"
