"""Rows that wait for the disk: in order, and bounded by a stated policy. Pure; the writer locks it."""

import math
from collections import Counter, deque
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import chain

Rows = Sequence[Sequence[object]]


class WaitingKind(Enum):
    """Kinds of rows, and how many of each may wait; beyond that the oldest are dropped. None: all wait."""

    KEPT = None
    """Frames, decisions, measurements, models, configurations: a decision or a measurement is never dropped. About 0.2
    MB a day."""
    READINGS = 100_000
    """Raw readings: an hour of 28 channels at 1 Hz."""
    STEPS = 20_000
    """Steps of the compensation."""
    EVENTS = 10_001
    """Events in words."""
    SNAPSHOTS = 1
    """A newer row replaces the waiting one; nothing is lost."""


@dataclass(frozen=True, slots=True)
class Item:
    """A statement for some rows."""

    number: int
    table: str
    statement: str
    rows: Rows
    kind: WaitingKind
    commit: bool
    """Commit as soon as nothing else waits."""
    since_s: float = 0.0
    """When it came, monotonic seconds."""


def tables_of(items: Iterable[Item]) -> "Counter[str]":
    """How many rows are of which table."""
    rows = Counter[str]()
    for item in items:
        if item.table:
            rows[item.table] += len(item.rows)
    return rows


class Waiting:
    """Items in order of arrival, those of WaitingKind.KEPT first: the order between tables does not matter."""

    def __init__(self) -> None:
        self._items: dict[WaitingKind, deque[Item]] = {kind: deque() for kind in WaitingKind}
        self._rows = dict.fromkeys(WaitingKind, 0)
        self.dropped = dict.fromkeys(WaitingKind, 0)
        """Dropped rows, by kind."""

    def __len__(self) -> int:
        return sum(map(len, self._items.values()))

    def __iter__(self) -> Iterator[Item]:
        return chain.from_iterable(self._items.values())

    @property
    def rows(self) -> int:
        """How many rows wait."""
        return sum(self._rows.values())

    def full(self, kind: WaitingKind) -> bool:
        """Whether another row of this kind drops the oldest."""
        return kind.value is not None and self._rows[kind] >= kind.value

    def put(self, item: Item) -> None:
        """Add the newest; drop the oldest of its kind beyond the bound."""
        self._items[item.kind].append(item)
        self._rows[item.kind] += len(item.rows)
        self._cut(item.kind)

    def oldest(self, kinds: Collection[WaitingKind]) -> float:
        """The smallest number of the waiting items of some kinds; infinity: none wait."""
        return min(
            (items[0].number for kind, items in self._items.items() if items and kind in kinds), default=math.inf
        )

    @property
    def since_s(self) -> float | None:
        """When the oldest row that waits came; None: none waits."""
        return min((item.since_s for items in self._items.values() for item in items if item.rows), default=None)

    def take(self) -> Item | None:
        """The oldest that is kept, before the oldest of the rest; None: nothing waits."""
        others = [items for items in self._items.values() if items]
        if not others:
            return None
        first = self._items[WaitingKind.KEPT] or min(others, key=lambda items: items[0].number)
        item = first.popleft()
        self._rows[item.kind] -= len(item.rows)
        return item

    def put_back(self, items: Iterable[Item]) -> None:
        """Put back items that could not be stored, oldest first."""
        for item in reversed(list(items)):
            self._items[item.kind].appendleft(item)
            self._rows[item.kind] += len(item.rows)
        for kind in WaitingKind:
            self._cut(kind)

    def _cut(self, kind: WaitingKind) -> None:
        items = self._items[kind]
        while kind.value is not None and self._rows[kind] > kind.value and len(items) > 1:
            gone = len(items.popleft().rows)
            self._rows[kind] -= gone
            self.dropped[kind] += gone if kind is not WaitingKind.SNAPSHOTS else 0
