"""What a Modbus device of somebody else is like: drawn from a seed, a few oddities at once."""

import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from tests.benches.strangers.nature import Told
from tests.benches.strangers.nature import log_uniform as _log


@dataclass(frozen=True)
class Nature(Told):
    """How it behaves; what is 0, none or empty does not occur. Times are seconds, shares 0 to 1."""

    wire: str = "tcp"
    """`tcp`, or `rtu`: the same line with frames that have a checksum and no number."""
    units: int = 1
    """Unit 1, and unit 2 behind it, which shares the line."""
    only_last: bool = False
    """Whether only the last unit is odd, where the oddity is a unit's."""
    blocks: int = 1
    """How many requests each unit needs."""
    alike: bool = True
    """Whether the answers to those have one length."""
    period_s: float = 1.0
    timeout_s: float = 0.5
    # A connection.
    mute_s: float = 0.0
    """After a connection it swallows what comes."""
    lingers_s: float = 0.0
    """It has one client, and notices so late that it has gone; a second one is refused, or never served."""
    second: str = "refused"
    closes_after: int = 0
    """Answers on one connection."""
    closes_idle_s: float = 0.0
    behind: int = 0
    """So many of its first connections answer each request with the answer to the one before; -1: all of them."""
    # A unit.
    took_s: float = 0.002
    jitter_s: float = 0.0
    slower: float = 0.0
    """Share of the answers that take `slower_s` longer."""
    slower_s: float = 0.0
    in_order: bool = True
    """Whether an answer waits for those before it."""
    rest_s: float = 0.0
    """What comes sooner after an answer is ignored, or refused with this exception."""
    rest_code: int = 0
    swallows: float = 0.0
    burst_code: int = 0
    """Exception of everything for `burst_s`, every `every_s`; -1: it is silent."""
    burst_s: float = 0.0
    every_s: float = 30.0
    restarts: bool = False
    """Whether the bursts are restarts: connections end, and new ones are refused meanwhile."""
    # A frame.
    number: str = "right"
    """Of the transaction: `right`, `zero`, `swapped`, `next`."""
    answers_as: int = -1
    """The unit id that all its answers have."""
    pieces_s: float = 0.0
    """Between the parts in which an answer comes."""
    flips: float = 0.0
    """Share of the frames with a wrong bit, where a checksum shows it."""
    twice: float = 0.0
    """Share of the answers that come twice."""
    noise: float = 0.0
    """Share of the answers with other bytes before them."""
    echoes: bool = False


Oddity = Callable[[random.Random, Nature], Mapping[str, object]]

_CONNECTION: tuple[Oddity, ...] = (
    lambda d, _: {"mute_s": _log(d, 0.05, 3.0)},
    lambda d, _: {"lingers_s": _log(d, 0.1, 5.0), "second": d.choice(("refused", "mute"))},
    lambda d, _: {"closes_after": d.choice((1, 1, 2, 3, 10))},
    lambda d, _: {"closes_idle_s": _log(d, 0.02, 3.0)},
    lambda d, n: {"behind": d.choice((1, 3, -1)) if n.wire == "tcp" else d.choice((1, -1))},
)
_UNIT: tuple[Oddity, ...] = (
    lambda d, n: {"took_s": _log(d, 0.05, max(0.06, 0.7 * n.period_s / (n.units * n.blocks)))},
    lambda d, n: {"took_s": _log(d, 0.05, max(0.06, 0.7 * n.period_s / (n.units * n.blocks)))},
    lambda d, _: {"jitter_s": _log(d, 0.01, 0.3)},
    lambda d, n: {"slower": _log(d, 0.02, 0.3), "slower_s": _log(d, 0.1, n.period_s)},
    lambda d, n: {"slower": _log(d, 0.02, 0.3), "slower_s": _log(d, 0.1, n.period_s), "in_order": n.wire == "rtu"},
    lambda d, _: {"rest_s": _log(d, 0.005, 0.4)},
    lambda d, n: {"rest_s": _log(d, 0.005, 0.3), "rest_code": d.choice((6, 11, 10, 5) if n.wire == "tcp" else (6,))},
    lambda d, _: {"swallows": _log(d, 0.01, 0.25)},
    lambda d, _: {"burst_code": d.choice((2, 6, 4, -1)), "burst_s": _log(d, 0.2, 8.0), "every_s": d.uniform(12, 40)},
    lambda d, _: {"burst_code": -1, "restarts": True, "burst_s": _log(d, 0.2, 5.0), "every_s": d.uniform(15, 40)},
)
_TCP_FRAME: tuple[Oddity, ...] = (
    lambda d, _: {"number": d.choice(("zero", "swapped", "next"))},
    lambda d, _: {"answers_as": d.choice((0, 1, 255))},
    lambda d, _: {"pieces_s": _log(d, 0.001, 0.05)},
)
_RTU_FRAME: tuple[Oddity, ...] = (
    lambda d, _: {"flips": _log(d, 0.01, 0.2)},
    lambda d, _: {"twice": _log(d, 0.05, 1.0)},
    lambda d, _: {"noise": _log(d, 0.05, 1.0)},
    lambda d, _: {"pieces_s": _log(d, 0.001, 0.01)},
    lambda _, __: {"echoes": True},
)


def drawn(draw: random.Random) -> Nature:
    """One of them."""
    wire = draw.choice(("tcp", "rtu"))
    plain: dict[str, object] = {
        "wire": wire,
        "units": draw.choice((1, 1, 2)),
        "only_last": draw.random() < 0.7,
        "blocks": draw.choice((1, 2, 2, 3)),
        "alike": draw.random() < 0.7,
        "period_s": draw.choice((0.5, 1.0, 1.0, 3.0)),
        "timeout_s": draw.choice((0.3, 0.5, 1.0)),
    }
    frame = _TCP_FRAME if wire == "tcp" else _RTU_FRAME
    for _ in range(draw.choice((1, 1, 1, 2, 2, 3))):
        oddities = draw.choice((_CONNECTION, _UNIT, _UNIT, _UNIT, frame))
        plain |= draw.choice(oddities)(draw, Nature(**plain))  # type: ignore[arg-type]
    if wire == "rtu" and plain.get("behind"):
        plain["twice"] = 0.0  # nobody can tell the copy of an answer from one that is behind
    return Nature(**plain)  # type: ignore[arg-type]


@dataclass
class Memory:
    """What one unit's registers hold: which register it is, and when that was measured."""

    unit: int
    places: Mapping[tuple[int, int], int] = field(default_factory=dict)
    """Function and address of each register, to its number 0..7."""
    per_s: float = 100.0
    """The resolution of the time that it tells."""

    def word(self, function: int, address: int, at_s: float) -> int | None:
        """None: it has no such register."""
        number = self.places.get((function, address))
        return None if number is None else (self.unit - 1) << 15 | number << 12 | round(at_s * self.per_s) % 4096


def told(word: int) -> tuple[int, int, int]:
    """Unit, number of the register, and when it was measured, in parts of a second (`Memory.per_s`) modulo 4096."""
    return (word >> 15) + 1, word >> 12 & 7, word & 4095


def age_s(word: int, now_s: float, per_s: float = 100.0) -> float:
    """How long ago it was measured, modulo 4096 parts of a second."""
    return (round(now_s * per_s) - told(word)[2]) % 4096 / per_s
