"""Values of inputs that are none: what a sensor, its wiring or its unit reports instead of a temperature.

Each fault is a statement about one step of an input that has lived until then: where it would leap to. Only a leap far
beyond anything that the input has done before, which lands there, is taken for the fault. Any other change counts as a
change of the machine, however fast: coolant on a sensor, a spindle that starts.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

from talc.frame import BoolArray, FloatArray, IntArray
from talc.learner.inputs import InputMemory
from talc.steps import steps_in

_LEAP: Final = 15.0
"""K in a step: a temperature moves less."""
_BEYOND: Final = 10.0
"""Times the largest step that an input has made: less is no leap."""
_LIVED: Final = 24
"""Steps in which an input must have changed."""
_CODE_OFF: Final = 0.05
"""How far from a code; a mean of codes is one."""
_UNIT_OFF: Final = 3.0
"""How far from its last value in another unit: times its largest step, and the least step, K."""
_LEAST_STEP: Final = 0.1
_LEFT: Final = 0.25
"""Share of the two leaps that an exchange may leave unexplained."""
_TOLD: Final = 25.0
"""How much nearer to what the other inputs imply two must be, in squared standard deviations, if they are exchanged; or
if they are not, to end an exchange by that alone."""
_LEAST_EXCHANGE: Final = 1.0
"""K; an exchange of inputs that are closer is none that matters."""
_SMOOTH: Final = 0.3
"""Share of its range that a smooth input covers in a step at most. Neither a state nor noise is smooth."""
_ALWAYS: Final = 0.8
"""Share of its steps in which an input changes that may be called frozen when it does not."""
_FROZEN_S: Final = 4 * 3600.0


class InputFault(StrEnum):
    """What an input reports instead of its value."""

    POWER_ON = "power_on"
    """85 °C: a DS18B20 that has not converted since it was switched on."""
    NO_SENSOR = "no_sensor"
    """-127 °C: no DS18B20 answered."""
    FAHRENHEIT = "fahrenheit"
    KELVIN = "kelvin"
    TENTHS = "tenths"
    """Ten times its value: tenths of a degree."""
    TENS = "tens"
    """A tenth of its value."""
    EXCHANGED = "exchanged"
    """With another input."""
    FROZEN = "frozen"
    """The same value, to the last digit, for hours, of an input that always moved."""


FAULTS: Final = tuple(InputFault)
_CODES: Final = {InputFault.POWER_ON: 85.0, InputFault.NO_SENSOR: -127.0}
_UNITS: Final = {
    InputFault.FAHRENHEIT: (1.8, 32.0),
    InputFault.KELVIN: (1.0, 273.15),
    InputFault.TENTHS: (10.0, 0.0),
    InputFault.TENS: (0.1, 0.0),
}
"""Factor and offset."""
_LOST: Final = frozenset({*_CODES, InputFault.FROZEN})
_NONE: Final = -1
SHORT_GAP: Final = 2
"""Steps without a row across which an input's change is still judged as a step's."""


@dataclass(frozen=True, slots=True)
class Suspicion:
    """A fault that begins."""

    fault: InputFault
    input: int
    other: int
    """The input that it is exchanged with; else `input`."""

    def told(self, names: Sequence[str], values: FloatArray) -> dict[str, object]:
        """What an event tells of it."""
        if self.fault is InputFault.EXCHANGED:
            return {"input": names[self.input], "other": names[self.other]}
        value = float(values[self.input])
        return {"input": names[self.input], "value": value, "input_fault": self.fault.value}


class InputCheck:
    """Judges each row of inputs by the rows before it.

    Parameters
    ----------
    inputs: n
    step_s: grid step
    """

    def __init__(self, inputs: int, step_s: float) -> None:
        self._frozen = steps_in(_FROZEN_S, step_s)
        self.habit = np.zeros((inputs, 6))
        """(n, 6) of good values: rows, those with a change, the largest change, the lowest and the highest value, and
        the latest rows without any change; instead of these, while it is frozen, the value."""
        self.fault = np.full((inputs, 2), _NONE, dtype=np.int64)
        """(n, 2) place in FAULTS, -1: none; and the input that it is exchanged with."""
        self._alike = np.zeros(inputs, dtype=np.bool_)
        """(n,) inputs that are exchanged, and so close to each other that a step may hide that they no longer are."""
        self.same = np.zeros(inputs, dtype=np.bool_)
        """(n,) inputs whose fault has ended in the latest row: they are the sensors that they were before it."""

    @property
    def doubted(self) -> BoolArray:
        """(n,) inputs with a fault."""
        return np.asarray(self.fault[:, 0] != _NONE)

    @property
    def lost(self) -> BoolArray:
        """(n,) inputs of which nothing is known in the latest row."""
        lost = [place != _NONE and FAULTS[place] in _LOST for place in self.fault[:, 0].tolist()]
        return np.asarray(lost, dtype=np.bool_) | self._alike

    def mended(self, values: FloatArray) -> FloatArray:
        """(n,) values of a row that was judged: those in another unit in their own, those exchanged in their place."""
        found = values.copy()
        for i in np.flatnonzero(self.doubted).tolist():
            place, other = self.fault[i].tolist()
            if FAULTS[place] in _UNITS:
                factor, offset = _UNITS[FAULTS[place]]
                found[i] = (values[i] - offset) / factor
            elif FAULTS[place] is InputFault.EXCHANGED:
                found[i] = values[other]
        return found

    def judge(self, values: FloatArray, valid: BoolArray, memory: InputMemory, *, gap: bool = False) -> list[Suspicion]:
        """Take in one row of (n,) values. Returns the faults that begin; `doubted` are then all that last.

        memory: of the rows before this one, mended; gap: there are steps without a row between
        """
        last = memory.last
        ended = self._end(values, valid, memory)
        healthy = valid & memory.known & (memory.away == 0) & ~self.doubted & (not gap)
        change = values - last
        begun = [
            found
            for found in self._exchanges(values, last, change, healthy)
            if memory.as_exchanged(values, healthy, found.input, found.other) > _TOLD
        ]
        for found in begun:
            self._begin(found)
        for found in self._leaps(values, last, change, (healthy | ended) & ~self.doubted):
            self._begin(found)
            begun.append(found)
        self.same = ended & ~self.doubted
        return begun + self._note(values, valid, change, healthy)

    def _begin(self, found: Suspicion) -> None:
        place = FAULTS.index(found.fault)
        self.fault[found.input] = place, found.other
        if found.fault is InputFault.EXCHANGED:
            self.fault[found.other] = place, found.input

    def _end(self, values: FloatArray, valid: BoolArray, memory: InputMemory) -> BoolArray:
        """End faults: the value is nearer to where it should be than to what the fault makes of that. Returns (n,) the
        inputs that are as before."""
        ended, self._alike = np.zeros((2, len(values)), dtype=np.bool_)
        last = memory.last
        for i in np.flatnonzero(self.doubted & valid).tolist():
            place, other = self.fault[i].tolist()
            if place == _NONE:  # ended with the input that it was exchanged with
                continue
            fault, value = FAULTS[place], float(values[i])
            if fault in _CODES:
                over = abs(value - _CODES[fault]) > _CODE_OFF
            elif fault in _UNITS:
                factor, offset = _UNITS[fault]
                over = abs(value - last[i]) < abs(value - (factor * last[i] + offset))
            elif fault is InputFault.EXCHANGED:
                here = abs(value - last[i]) + abs(values[other] - last[other])
                over = bool(valid[other] and here < abs(value - last[other]) + abs(values[other] - last[i]))
                self._alike[i] = abs(value - values[other]) <= self.habit[i, 2] + self.habit[other, 2]
                told = memory.as_exchanged(values, valid & ~self.doubted, i, other)
                over = (over and not self._alike[i]) or told < -_TOLD
            else:
                over = value != self.habit[i, 5]
            if over:
                both = [i, other] if fault is InputFault.EXCHANGED else [i]
                self.fault[both], ended[both] = _NONE, True
        return ended

    def _leaps(self, values: FloatArray, last: FloatArray, change: FloatArray, judged: BoolArray) -> list[Suspicion]:
        largest, smooth = self.habit[:, 2], self._smooth()
        leapt = judged & (self.habit[:, 1] >= _LIVED) & (np.abs(change) > np.maximum(_LEAP, _BEYOND * largest))
        found = []
        for i in np.flatnonzero(leapt).tolist():
            value, reach = float(values[i]), _UNIT_OFF * max(float(largest[i]), _LEAST_STEP)
            near = [fault for fault, code in _CODES.items() if abs(value - code) <= _CODE_OFF]
            near += [
                fault
                for fault, (factor, offset) in _UNITS.items()
                if smooth[i] and abs(value - (factor * float(last[i]) + offset)) <= factor * reach
            ]
            found += [Suspicion(fault, i, i) for fault in near[:1]]
        return found

    def _exchanges(
        self, values: FloatArray, last: FloatArray, change: FloatArray, healthy: BoolArray
    ) -> list[Suspicion]:
        far = np.abs(change) > _LEAST_EXCHANGE
        places = np.flatnonzero(healthy & self._smooth() & far).tolist()
        found: list[Suspicion] = []
        for a, i in enumerate(places):
            for j in places[a + 1 :]:
                left = abs(values[i] - last[j]) + abs(values[j] - last[i])
                taken = any(j in (each.input, each.other) or i in (each.input, each.other) for each in found)
                if not taken and left <= _LEFT * (abs(change[i]) + abs(change[j])):
                    found.append(Suspicion(InputFault.EXCHANGED, i, j))
        return found

    def _smooth(self) -> BoolArray:
        rows, moved, largest, low, high, _ = self.habit.T
        return np.asarray((moved >= _LIVED) & (largest <= _SMOOTH * (high - low)) & (rows > 0))

    def _note(self, values: FloatArray, valid: BoolArray, change: FloatArray, healthy: BoolArray) -> list[Suspicion]:
        """The habits of what is good, and the inputs that have frozen."""
        good = valid & ~self.doubted
        rows, moved, largest, low, high, alike = self.habit.T.copy()
        first, step = good & (rows == 0), np.where(healthy & good, np.abs(change), 0.0)
        alike = np.where(healthy & good & (step == 0.0), alike + 1.0, 0.0)
        frozen = self._smooth() & (moved >= _ALWAYS * rows) & (alike >= self._frozen)
        self.habit = np.column_stack(
            [
                rows + good,
                moved + (step > 0.0),
                np.maximum(largest, step),
                np.where(good, np.where(first, values, np.minimum(low, values)), low),
                np.where(good, np.where(first, values, np.maximum(high, values)), high),
                np.where(good, alike, self.habit[:, 5]),
            ]
        )
        found = [Suspicion(InputFault.FROZEN, i, i) for i in np.flatnonzero(frozen).tolist()]
        for each in found:
            self._begin(each)
            self.habit[each.input, 5] = values[each.input]  # what it must differ from
        return found


@dataclass(slots=True)
class StrangeCells:
    """Cells of a column of inputs that one fault has made."""

    input: str
    fault: InputFault
    other: str
    """The input that it is exchanged with; else itself."""
    first: int
    """Row of the first one."""
    count: int = 0


def strange_cells(names: Sequence[str], inputs: FloatArray, k: IntArray, step_s: float) -> list[StrangeCells]:
    """All of a recording, by input and fault: what the learner mends or leaves out.

    inputs: (T, n), NaN: no value; k: (T,) grid indices, ascending
    """
    memory, check = InputMemory(len(names), step_s), InputCheck(len(names), step_s)
    found: dict[tuple[int, int], StrangeCells] = {}
    last_k = int(k[0]) - 1
    for row, (index, values) in enumerate(zip(k.tolist(), inputs, strict=True)):
        valid = np.isfinite(values)
        present = np.where(valid, values, 0.0)
        check.judge(present, valid, memory, gap=index - last_k - 1 > SHORT_GAP)
        memory.fill(check.mended(present), valid & ~check.lost, check.same)
        last_k = index
        for i in np.flatnonzero(check.doubted & valid).tolist():
            place, other = check.fault[i].tolist()
            cells = StrangeCells(names[i], FAULTS[place], names[other], row)
            found.setdefault((i, place), cells).count += 1
    return list(found.values())
