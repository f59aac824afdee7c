"""Shared memory that a killed gateway leaves to the next one: its control, and what it had reported."""

import mmap
import pickle
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from simulators.nc import Nck
from simulators.nc.watchdog import Logged

_HEAD = struct.Struct("=QQ")


@dataclass
class WhatOutlives:
    """What remains after the gateway's death: its control, and what the gateway had reported."""

    nck: "KeptNck"
    now_s: float = 0.0
    decided: list[int] = field(default_factory=list)
    """Grid indices of the steps that were decided."""
    stored: list[int] = field(default_factory=list)
    """The steps that the store reported to be on the disk."""
    requests: list[int] = field(default_factory=list)
    """Numbers of the requested cycles."""


class SharedMemory:
    """Two copies in memory that a child shares with its parent; the newer one counts once it is whole."""

    _SIZE = 1 << 22

    def __init__(self) -> None:
        self._memory, self._count = mmap.mmap(-1, 2 * self._SIZE), 0

    def keep(self, what: WhatOutlives) -> None:
        self._count += 1
        data, at = pickle.dumps(what), (self._count % 2) * self._SIZE
        self._memory[at : at + _HEAD.size] = _HEAD.pack(0, 0)
        self._memory[at + _HEAD.size : at + _HEAD.size + len(data)] = data
        self._memory[at : at + _HEAD.size] = _HEAD.pack(self._count, len(data))

    def kept(self) -> WhatOutlives:
        copies = [_HEAD.unpack_from(self._memory, n * self._SIZE) for n in range(2)]
        newest = max(range(2), key=lambda n: int(copies[n][0]))
        at, size = newest * self._SIZE + _HEAD.size, copies[newest][1]
        self._count = copies[newest][0]
        found = pickle.loads(self._memory[at : at + size])
        assert isinstance(found, WhatOutlives)
        return found


class KeptNck(Nck):
    """Reports whenever a gateway has changed it."""

    changed: Callable[[], None] = staticmethod(lambda: None)
    moved_in_cycle = 0
    """How often a gateway has changed an offset while the control probed."""

    def __getstate__(self) -> dict[str, object]:
        """The log in plain tuples: it is pickled at each change."""
        return self.__dict__ | {"log": [(one.time_s, one.values_mm, one.ramped) for one in self.log]}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state | {"log": [Logged(*one) for one in state["log"]]})

    def write_r(self, number: int, value: float, now_s: float) -> None:
        super().write_r(number, value, now_s)
        KeptNck.changed()

    def write_k0(self, axis: int, value_mm: float, now_s: float) -> None:
        self.moved_in_cycle += self.cycle.started_s is not None and value_mm != self.k0_mm[axis]
        super().write_k0(axis, value_mm, now_s)
        KeptNck.changed()
