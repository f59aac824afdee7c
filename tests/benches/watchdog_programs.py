"""TALC_START, TALC_SLOPES and TALC_ERRORS from many states: `python -m tests.benches.watchdog_programs --states 620`.

They run in the interpreter, at power on and by hand. What they have to do is written here from docs/nc.md, as values of
R-parameters, offsets and slopes. The command takes the states of tests/benches/nc_starts.py, and prints how each ended
and what was otherwise.
"""

import argparse
import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import chain
from typing import Any

import numpy as np

from drivers.sinumerik.programs import ErrorTerms, errors_program
from drivers.sinumerik.settings import OffsetRoute, SinumerikSettings
from simulators.nc.main_run import LENGTHS, LINEAR, MainRun
from simulators.nc.nck import CEC_TABLES
from simulators.nc.synchronised import ProgramAlarm, SystemVariable
from tests.benches.nc_starts import USUAL, State, made, states, tell
from tests.benches.probing_programs import FOLDER, Cell, program_texts

Texts = Mapping[str, str]
TRAVEL = ((-200.0, 200.0), (-200.0, 200.0), (0.0, 300.0))
SILENCE_S, RAMP_MM_S, SLOPE_RAMP = 0.5, 2e-3, 2e-6
IPO_S = 0.02
_MARK = 3.0
"""In every R-parameter before: what is not written stays."""
_EARLIER, _OWNER, _BEAT, _AGE = 61, 93, 94, 1e6
_LEASE_ZERO = (89, 93, 95, 96, 97)
_ZERO = {
    "START": (*_LEASE_ZERO, 90, 91, 92, 98),
    "SLOPES": (98,),
    "ERRORS": (*_LEASE_ZERO, *range(100, 109), *range(110, 119), 120, 121, 122, *range(130, 136)),
}
_TERMS = (1.0, 120.0, 60.0, 50.0, 70.0, 200.0, math.hypot(200.0, 300.0), -300.0)
"""Slew, radius, bounds, and reach along X and across it, mm; range of the tool's length (it reads it)."""
_ECHO = {"START": 68, "ERRORS": 119}
_OWN = {
    "START": ("SA_TEMP_COMP_ABS_VALUE",),
    "SLOPES": ("SA_TEMP_COMP_SLOPE", "SN_CEC_TABLE_WEIGHT"),
    "ERRORS": ("SA_TEMP_COMP_ABS_VALUE",),
}
_LITTLE = {"SA_TEMP_COMP_ABS_VALUE": 1e-4, "SA_TEMP_COMP_SLOPE": 1e-8, "SN_CEC_TABLE_WEIGHT": 1e-5}
"""So much already counts as in force; mm, 1, 1."""


def watchdog_texts() -> dict[str, str]:
    """By name; TALC_ERRORS as it is made for a machine."""
    settings = SinumerikSettings(
        security="none",
        url="opc.tcp://nc",
        origin_tool_mm=0.0,
        compensation=OffsetRoute(route="errors", travel_mm=TRAVEL),
    )
    made_here = errors_program(settings, ErrorTerms(1.0, 120.0, (60.0, 50.0, 70.0)))
    return {name: (FOLDER / f"TALC_{name}.SPF").read_text("utf-8") for name in ("START", "SLOPES")} | {
        "ERRORS": made_here
    }


class Control:
    """A cell whose main run takes the actions of its programs."""

    def __init__(self, state: State, texts: Texts, more: Sequence[str] = ()) -> None:
        whole = {**program_texts(), **texts, **{f"part {n}": text for n, text in enumerate(more)}}
        self.cell: Cell = made(state, whole)
        self.settings = {
            "SA_TEMP_COMP_ABS_VALUE": [0.0] * 3,
            "SA_TEMP_COMP_SLOPE": [0.0] * 3,
            "SN_CEC_TABLE_WEIGHT": [0.0] * len(CEC_TABLES),
        }
        self.run = MainRun([], self.cell.r, self.settings, "XYZAC", IPO_S, 0.0)
        self.version_before_an_action = False
        numbers = {axis: number for number, axis in enumerate(LINEAR)}
        self.cell.channel.actions = self._load
        self.cell.channel.variables |= {
            name: SystemVariable(
                values, numbers if name.startswith("SA_") else None, lengths=range(3) if name in LENGTHS else range(0)
            )
            for name, values in self.settings.items()
        }

    def _load(self, text: str) -> None:
        self.version_before_an_action |= self.cell.r[99] != 0.0
        self.run.actions.load(text)

    def call(self, name: str, event: int = 4) -> None:
        """From PROG_EVENT after power on (4), or by hand (0)."""
        self.cell.channel.told.event = event
        self.cell.channel.start(name)
        self.cell.channel.told.event = 0

    def turn(self, seconds: float) -> None:
        for _ in range(round(seconds / IPO_S)):
            self.run.cycle([150.0, -80.0, 120.0, 30.0, 70.0])

    @property
    def left(self) -> float:
        """The largest of everything that may be in force."""
        values = (*chain.from_iterable(self.settings.values()), *self.cell.r[90:93], *self.cell.r[110:119])
        return max(map(abs, values))


def run_at_power_on(state: State, name: str, texts: Texts) -> tuple[str, list[str]]:
    """How it ended, and what was not as it has to be."""
    control = Control(state, texts)
    cell, r = control.cell, control.cell.r
    r[68:137] = [_MARK] * 69
    r[_EARLIER], r[65], r[_BEAT], r[89] = 0.0, 2.0, 17.0, 2.0
    for own in _OWN[name]:
        control.settings[own][:] = [_LITTLE[own]] * len(control.settings[own])
    before, old = cell.state(), list(r)
    try:
        control.call(f"TALC_{name}")
    except ProgramAlarm as alarm:
        stopped = state["control is"] == "stopped by an alarm" or (state["not referenced"] and state["start lock"])
        expected = stopped or state["group 7"] != "G40"
        nothing = r == old and not control.run.actions.numbers and not cell.moves
        return "start refused by the control", [] if expected and nothing else [str(alarm)]
    wrong = [] if (cell.state(), cell.moves) == (before, []) else [f"{before} became {cell.state()}"]
    wrong += [f"R{number} = {r[number]:g}, not 0" for number in _ZERO[name] if r[number]]
    wrong += [f"{own} is not 0" for own in _OWN[name] if any(control.settings[own])]
    if name != "SLOPES":
        if r[60:62] != [7.0, 7.0] or r[65:67] != [5.0, 7.0]:
            wrong.append("an earlier request or cycle is left")
        if (r[_ECHO[name]], r[69]) != (17.0, _AGE):
            wrong.append("the last beat could be taken for a new one")
    if name == "ERRORS" and (r[99] != 3.0 or not np.allclose([*r[123:130], r[136]], _TERMS)):
        wrong.append(f"R99 = {r[99]:g} is not the version, or R123 to R129 = {r[123:130]}, R136 = {r[136]:g}")
    skipped = state["control is"] in ("searching", "testing", "simulating")
    if len(control.run.actions.numbers) != (0 if skipped else texts[name].count("\nIDS=")):
        wrong.append(f"{len(control.run.actions.numbers)} actions")
    return ("started without its actions" if skipped else "started"), wrong


def by_hand(state: State, name: str, texts: Texts) -> list[str]:
    """With something in force it changes nothing, says so and waits, each value alone; with nothing it starts."""
    wrong = []
    cases: list[tuple[str, int]] = [
        (own, n) for own in _OWN[name] for n in range(len(Control(state, texts).settings[own]))
    ]
    cases += [("R", number) for number in (90, 91, 92) if name == "START"]
    for own, number in [*cases, ("", 0)]:
        control = Control(state, texts)
        values: list[float] = control.cell.r if own == "R" else control.settings.get(own, [0.0])
        values[number] = -_LITTLE.get(own, 1e-4) if own else 0.0
        before = [list(control.cell.r), {key: list(found) for key, found in control.settings.items()}]
        control.call(f"TALC_{name}", event=0)
        same = before == [control.cell.r, control.settings] and not control.run.actions.numbers
        waited = len(control.cell.halts) == 1 and all(control.cell.halts)
        if (same and waited) is not bool(own):
            wrong.append(
                f"by hand with {own}[{number}]: halts {control.cell.halts}, {'the' if same else 'not the'} same"
            )
    return wrong


def _from(state: Mapping[str, Any], name: str) -> Callable[[Texts], list[str]]:
    def case(texts: Texts) -> list[str]:
        return run_at_power_on(state, name, texts)[1] + by_hand(state, name, texts)

    return case


def _after_a_move(name: str) -> Callable[[Texts], list[str]]:
    """Nothing is written while an axis still moves."""

    def case(texts: Texts) -> list[str]:
        part = f"PROC PART_PROGRAM DISPLOF\nSUPA G1 Y=-60 F=1000\nTALC_{name}\nRET"
        control = Control(USUAL, texts, [part])
        control.cell.r[99] = _MARK if name == "ERRORS" else 0.0
        control.call("PART_PROGRAM")
        early = [number for number, _, _, moves in control.cell.channel.written if not moves]
        wrong = [f"R{number} is written while an axis moves" for number in early]
        return [*wrong, *["R99 tells a version before the last action"] * control.version_before_an_action]

    return case


def _watches(*names: str) -> Callable[[Texts], list[str]]:
    """Alive it copies each beat and holds; silent everything goes to zero at its rate, and a request ages. A claim that
    is given back is silence at once."""

    def case(texts: Texts) -> list[str]:
        control = _claimed(texts, names)
        wrong = list(_alive(control))
        return wrong or [*_silent(control), *_released(_claimed(texts, names))]

    return case


def _claimed(texts: Texts, names: Sequence[str]) -> Control:
    """Started, with a gateway that has something in force and asks for a cycle."""
    control = Control(USUAL, texts)
    for name in names:
        control.call(f"TALC_{name}")
    r, settings = control.cell.r, control.settings
    control.run.actions.load("IDS=120 DO $R[0] = $AC_TIMER[1]")
    r[95], r[97], r[98], r[93], r[60] = SILENCE_S, RAMP_MM_S, SLOPE_RAMP if "SLOPES" in names else 0.0, 7.0, 9.0
    if "ERRORS" in names:
        r[100:109] = [1.0] * 9
    else:
        settings["SA_TEMP_COMP_ABS_VALUE"][:], r[90:93] = [0.002, -0.003, 0.0005], [0.001, -0.001, 0.002]
    if "SLOPES" in names:
        settings["SA_TEMP_COMP_SLOPE"][:], settings["SN_CEC_TABLE_WEIGHT"][:] = [2e-6, -3e-6, 1e-6], [2e-3, -1e-3] * 3
    return control


def _alive(control: Control) -> Iterator[str]:
    r, errors = control.cell.r, any(control.cell.r[100:109])
    for beat in range(1, 11):
        r[_BEAT], held = float(beat), control.left
        control.turn(0.2)
        if (r[_ECHO["ERRORS" if errors else "START"]], r[96]) != (beat, 1.0):
            yield f"beat {beat} is not copied, or R96 = {r[96]:g}"
        if not errors and control.left != held:
            yield "alive it moves offsets"
    if abs(r[0] - 2.0) > 3 * IPO_S:
        yield f"the request is {r[0]:.2f} s old, not 2"
    if errors and not (min(r[110:119]) > 0.0 and all(control.settings["SA_TEMP_COMP_ABS_VALUE"])):
        yield "the errors do not come into force"


def _silent(control: Control) -> Iterator[str]:
    r, rates = control.cell.r, (RAMP_MM_S, SLOPE_RAMP, 1e3 * SLOPE_RAMP, RAMP_MM_S)
    r[60] = 10.0
    before = [*map(list, control.settings.values()), r[90:93]]
    control.turn(SILENCE_S - 0.1)
    for one, other, rate in zip(before, (*control.settings.values(), r[90:93]), rates, strict=True):
        if any(abs(a - b) > rate * 0.2 for a, b in zip(one, other, strict=True)):
            yield "silence makes a step"
    if r[96] != 2.0:
        yield f"R96 = {r[96]:g} in silence"
    control.turn(20.0)
    if control.left > 1e-12 or any(r[100:109]):
        yield f"{control.left:g} stays in force, or is wanted again"
    if abs(r[0] - 20.4) > 3 * IPO_S:
        yield f"the next request is {r[0]:.2f} s old"


def _released(control: Control) -> Iterator[str]:
    r = control.cell.r
    r[_BEAT] = 1.0
    control.turn(2 * IPO_S)
    alive, r[_OWNER] = r[96], 0.0
    control.turn(IPO_S)
    if (alive, r[96]) != (1.0, 2.0):
        yield f"R96 = {alive:g}, and {r[96]:g} once the claim is given back"
    r[_BEAT] = 2.0
    control.turn(2 * IPO_S)
    if r[_ECHO["ERRORS" if any(r[100:109]) or r[99] else "START"]] != 1.0:
        yield "a beat of nobody's is copied"


_INCH = USUAL | {"group 13": "G700"}
WATCHDOG_CASES: dict[str, dict[str, Callable[[Texts], list[str]]]] = {
    name: {
        "from a usual state": _from(USUAL, name),
        "from an inch program": _from(_INCH, name),
        "after a move": _after_a_move(name),
        "it watches": _watches(*(("START", "SLOPES") if name == "SLOPES" else (name,))),
    }
    for name in _OWN
}
"""By program."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--states", type=int, default=620)
    ended, bad, texts = Counter[str](), 0, watchdog_texts()
    for number, state in enumerate(states(parser.parse_args().states)):
        for name in texts:
            how, wrong = run_at_power_on(state, name, texts)
            ended[how] += 1
            bad += bool(wrong)
            if wrong:
                print(f"state {number}, TALC_{name}: {how}, but {'; '.join(wrong[:3])}", flush=True)
    tell(ended, "starts", bad)


if __name__ == "__main__":
    main()
