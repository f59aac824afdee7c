"""The NC program with which the control computes the offsets from nine errors, for one machine's data.

It consists of synchronised actions. They contain only what NC Programming, Programming Manual, 12/2019
(6FC5398-2EP40-0BA0), 2.15.7, lists for them: SIN and COS of degrees and ABS, but no MINVAL, and comparisons in
parentheses, because AND and OR bind tighter. The smaller of a and b is 0.5 * (a + b - ABS(a - b)); a value within plus
and minus b is 0.5 * (ABS(a + b) - ABS(a - b)).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from drivers.base import SetupError
from drivers.nc import ERRORS, LINEAR_AXES, Triple
from drivers.sinumerik.settings import SinumerikSettings, error_reach_mm

PROGRAM_VERSION: Final = 1
"""Version of the program and of the meaning of its parameters; the control shows it while the program is active."""
FIRST_ID: Final = 60
"""ID of the first static synchronised action; the others follow it."""
_IMPLAUSIBLE_UM: Final = 1_000_000
"""What would move the tool by a metre is an invalid number: nothing moves."""
_GONE_MM: Final = 0.00005
"""Offsets that together are less may go to zero at once."""
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
        raise SetupError(f"route = {settings.compensation.route!r}: only 'errors' needs a generated program")
    lines = [*_start(settings, terms)]
    for number, action in enumerate(_actions(settings, terms), FIRST_ID):
        lines.append(f"IDS={number} {action}")
    lines += ["STOPRE", f"R[{settings.errors.version}] = {PROGRAM_VERSION}", "RET"]
    return "\n".join(lines) + "\n"


def _start(settings: SinumerikSettings, terms: ErrorTerms) -> Iterator[str]:
    lease, errors, comp = settings.lease, settings.errors, settings.compensation
    along, across = error_reach_mm(settings)
    yield "; Offsets of X, Y, Z from nine thermal errors and from where the tool is, in each interpolation cycle."
    yield "; Written by talc-gateway nc sinumerik-files: do not change it here. HAS NOT RUN ON A REAL CONTROL."
    yield "; Call after power on instead of TALC_START, with the axes at rest. Parameters: docs/nc.md, Nine errors."
    yield "PROC TALC_ERRORS DISPLOF"
    yield "; By hand only while nothing is in force: what goes to zero here would be a step."
    yield "STOPRE"
    in_force = " + ".join(f"ABS($SA_TEMP_COMP_ABS_VALUE[{comp.axis_names[axis]}])" for axis in LINEAR_AXES)
    yield f"IF ($P_PROG_EVENT <> 4) AND ({in_force} > {_nc_number(_GONE_MM)})"
    yield '  MSG("TALC_ERRORS: offsets are in force. Stop the gateway, wait until they are 0, call it again")'
    yield from ("  M0", "  RET", "ENDIF")
    for axis in LINEAR_AXES:
        yield f"$SA_TEMP_COMP_ABS_VALUE[{comp.axis_names[axis]}] = 0"
    for number in (lease.owner, lease.silence, lease.state, lease.ramp, errors.version, errors.echo):
        yield f"R[{number}] = 0"
    for first, count in ((errors.wanted, ERRORS), (errors.in_force, ERRORS), (errors.probed, 3)):
        yield " ".join(f"R[{first + i}] = 0" for i in range(count))
    told = (terms.slew_um_per_s, terms.radius_mm, *terms.bound_um, along, across)
    yield " ".join(f"R[{errors.terms + i}] = {_nc_number(value)}" for i, value in enumerate(told))
    yield f"$AC_PARAM[1] = R[{lease.beat}]"
    yield "$AC_PARAM[2] = $MN_IPO_CYCLE_TIME"
    yield "$AC_PARAM[3] = -1"
    yield " ".join(f"$AC_PARAM[{number}] = 0" for number in (9, 21, 22, 23, 24, 25, 26))
    yield "STOPRE"
    yield "TALC_RESET"


def _actions(settings: SinumerikSettings, terms: ErrorTerms) -> Iterator[str]:
    """In the order in which a cycle runs them."""
    yield from _watchdog(settings)
    yield from _hold(settings)
    yield from _slew(settings, terms)
    yield from _geometry(settings, terms)
    yield from _output(settings, terms)


def _watchdog(settings: SinumerikSettings) -> Iterator[str]:
    """As in TALC_START, but on silence the wanted errors are zero, and the slew takes them there."""
    hand, lease = settings.handshake, settings.lease
    owner, beat, silence, state, ramp = (
        _r(n) for n in (lease.owner, lease.beat, lease.silence, lease.state, lease.ramp)
    )
    asked = _r(hand.request)
    yield f"WHENEVER {asked} <> $AC_PARAM[3] DO $AC_PARAM[3] = {asked} $AC_TIMER[1] = 0"
    yield f"WHENEVER ({beat} <> $AC_PARAM[1]) AND ({owner} > 0) DO $AC_PARAM[1] = {beat} $AC_TIMER[2] = 0 {state} = 1"
    yield f"WHENEVER ({state} == 1) AND (($AC_TIMER[2] > {silence}) OR ({owner} == 0)) DO {state} = 2"
    for first in range(0, ERRORS, 3):
        zero = " ".join(f"{_r(settings.errors.wanted + first + i)} = 0" for i in range(3))
        yield f"WHENEVER ({state} == 2) AND ({ramp} > 0) DO {zero}"


def _hold(settings: SinumerikSettings) -> Iterator[str]:
    """$AC_PARAM[8]: nothing moves from the first touch to the last while a gateway is alive. Both ends are at the same
    place, so that there is nothing to take back afterwards. The held shift is reported."""
    probing, state, first = _r(settings.handshake.state), _r(settings.lease.state), settings.errors.probed
    probes = f"({probing} > 1.5) AND ({probing} < 2.5)"
    yield "DO $AC_PARAM[8] = 0"
    yield f"WHENEVER {probes} AND ({state} == 1) DO $AC_PARAM[8] = 1"
    told = " ".join(f"{_r(first + axis)} = 0.001 * $AC_PARAM[{21 + axis}]" for axis in range(3))
    yield f"WHENEVER {probes} AND ($AC_PARAM[9] == 0) DO {told}"


def _slew(settings: SinumerikSettings, terms: ErrorTerms) -> Iterator[str]:
    """The errors in force move in proportion, so far that no point of the travel moves faster than the slew."""
    state, ramp = _r(settings.lease.state), f"1000 * {_r(settings.lease.ramp)}"
    slew = _nc_number(terms.slew_um_per_s)
    wanted = [_r(settings.errors.wanted + i) for i in range(ERRORS)]
    force = [_r(settings.errors.in_force + i) for i in range(ERRORS)]
    way = [f"ABS({w} - {e})" for w, e in zip(wanted, force, strict=True)]
    along_mm, across_mm = error_reach_mm(settings)
    along, across = _nc_number(along_mm * 1e-3), _nc_number(across_mm * 1e-3)
    grown = [_nc_number(reach / terms.radius_mm) for reach in (along_mm, across_mm)]
    yield f"DO $AC_PARAM[4] = {slew} * $AC_PARAM[2] $AC_PARAM[27] = 0.5 * {slew} * $AC_PARAM[2]"
    yield f"WHENEVER {state} <> 1 DO $AC_PARAM[4] = 0.5 * ({slew} + {ramp} - ABS({slew} - {ramp})) * $AC_PARAM[2]"
    bridged = "ABS($AC_PARAM[24]) + ABS($AC_PARAM[25]) + ABS($AC_PARAM[26])"
    yield f"WHENEVER ({bridged}) > 0.000001 DO $AC_PARAM[4] = 0.5 * $AC_PARAM[4]"
    yield f"DO $AC_PARAM[5] = {way[EX0C]} + {grown[0]} * {way[ER0T]} + {across} * ({way[EB0C]} + {way[EC0C]})"
    yield (
        f"DO $AC_PARAM[6] = {way[EY0C]} + {way[EZ0T]} + {grown[1]} * {way[ER0T]} + {across} * {way[EA0C]}"
        f" + {along} * ({way[EB0C]} + {way[EC0C]})"
    )
    higher = f"0.5 * ({way[EY0A]} + {way[EZ0A]} + ABS({way[EY0A]} - {way[EZ0A]}))"
    yield f"DO $AC_PARAM[6] = $AC_PARAM[6] + {higher}"
    yield "DO $AC_PARAM[5] = 0.5 * ($AC_PARAM[5] + $AC_PARAM[6] + ABS($AC_PARAM[5] - $AC_PARAM[6])) $AC_PARAM[7] = 0"
    yield "WHENEVER $AC_PARAM[5] <= $AC_PARAM[4] DO $AC_PARAM[7] = 1"
    part = f"($AC_PARAM[5] > $AC_PARAM[4]) AND ($AC_PARAM[4] > 0) AND ($AC_PARAM[5] < {_IMPLAUSIBLE_UM})"
    yield f"WHENEVER {part} DO $AC_PARAM[7] = $AC_PARAM[4] / $AC_PARAM[5]"
    yield "WHENEVER $AC_PARAM[8] == 1 DO $AC_PARAM[7] = 0"
    for first in range(0, ERRORS, 3):
        moved = (
            f"{force[i]} = {force[i]} + $AC_PARAM[7] * ({wanted[i]} - {force[i]})" for i in range(first, first + 3)
        )
        yield f"WHENEVER $AC_PARAM[7] > 0 DO {' '.join(moved)}"


def _geometry(settings: SinumerikSettings, terms: ErrorTerms) -> Iterator[str]:
    """The shift of the tool at the present position, µm, in $AC_PARAM[16], [19] and [20]: talc.kinematics."""
    names = settings.compensation.axis_names
    e = [_r(settings.errors.in_force + i) for i in range(ERRORS)]
    x, y, z = (
        _less(f"$AA_IM[{names[axis]}]", zero) for axis, zero in zip(LINEAR_AXES, settings.origin_mm, strict=True)
    )
    a, c, s = f"$AA_IM[{names['A']}]", "$AC_PARAM[10]", "$AC_PARAM[11]"
    px, py, pz, grown = (f"$AC_PARAM[{number}]" for number in (12, 13, 14, 15))
    yield f"DO {c} = COS({a}) {s} = SIN({a}) {px} = 0.001 * {x}"
    yield f"DO {py} = 0.001 * ({c} * {y} + {s} * {z}) {pz} = 0.001 * ({c} * {z} - {s} * {y})"
    yield f"DO {grown} = {_nc_number(1000.0 / terms.radius_mm)} * {e[ER0T]}"
    yield f"DO $AC_PARAM[16] = {e[EX0C]} + {grown} * {px} + {e[EB0C]} * {pz} - {e[EC0C]} * {py}"
    yield f"DO $AC_PARAM[17] = {e[EY0C]} + {grown} * {py} - {e[EA0C]} * {pz} + {e[EC0C]} * {px}"
    yield f"DO $AC_PARAM[18] = {e[EZ0T]} + {e[EA0C]} * {py} - {e[EB0C]} * {px}"
    yield f"DO $AC_PARAM[19] = {e[EY0A]} + {c} * $AC_PARAM[17] - {s} * $AC_PARAM[18]"
    yield f"DO $AC_PARAM[20] = {e[EZ0A]} + {s} * $AC_PARAM[17] + {c} * $AC_PARAM[18]"


def _output(settings: SinumerikSettings, terms: ErrorTerms) -> Iterator[str]:
    """Within the bound, to K0. What would be a step after a cycle goes into a bridge, which the slew takes back."""
    comp = settings.compensation
    target = [f"$AC_PARAM[{number}]" for number in (16, 19, 20)]
    out, bridge = ([f"$AC_PARAM[{first + axis}]" for axis in range(3)] for first in (21, 24))
    bounds = [_nc_number(bound) for bound in terms.bound_um]
    free = "WHENEVER $AC_PARAM[8] == 0 DO"
    each = range(3)
    yield "DO " + " ".join(f"{target[i]} = {_within(target[i], bounds[i])}" for i in each)
    left = " ".join(f"{bridge[i]} = {out[i]} - {target[i]}" for i in each)
    yield f"WHENEVER ($AC_PARAM[9] == 1) AND ($AC_PARAM[8] == 0) DO {left}"
    yield f"{free} " + " ".join(f"{bridge[i]} = {bridge[i]} - {_within(bridge[i], '$AC_PARAM[27]')}" for i in each)
    yield f"{free} " + " ".join(f"{out[i]} = {_within(f'{target[i]} + {bridge[i]}', bounds[i])}" for i in each)
    for i, axis in enumerate(LINEAR_AXES):
        minus = "0 - " if comp.sign(i) < 0 else ""
        yield f"{free} $$SA_TEMP_COMP_ABS_VALUE[{comp.axis_names[axis]}] = {minus}0.001 * {out[i]}"
    yield f"DO $AC_PARAM[9] = $AC_PARAM[8] {_r(settings.errors.echo)} = {_r(settings.lease.beat)}"


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
