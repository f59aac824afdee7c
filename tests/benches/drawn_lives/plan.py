"""What happens in a life, drawn from its seed."""

import errno
import random
from collections.abc import Mapping
from dataclasses import dataclass, replace

from tests.benches.drawn_lives.agent_host import Disturbances
from tests.benches.strangers import modbus_nature
from tests.benches.strangers.nature import log_uniform

QUIET_S = 1500.0
"""At its end nothing more happens, so that everything can recover."""
_PATIENCE = 4.0
_FAILS_AT_A_START = 0.4
"""Share of the restarts that a failing disk goes with."""
_ERRNOS = (errno.ENOSPC, errno.EIO, errno.EROFS)


@dataclass(frozen=True)
class Trouble:
    """One thing that happens. Times in seconds since the beginning."""

    at_s: float
    lasts_s: float
    disk: int = 0
    """The error of what changes the disk."""
    call: int = 1
    """At which call from then on it begins; if it does not last it is this one's alone."""
    control: Disturbances | None = None
    clock_s: float = 0.0
    """The wall clock is ahead by as much, and no time server keeps it."""
    restarts: str = ""
    """`stopped` or `killed`, and started again after `lasts_s`; `power cut`: killed with the computer; `damaged`: the
    database of one that was stopped."""


@dataclass(frozen=True)
class Plan:
    """A life."""

    seed: int
    lasts_s: float
    when_stale: str
    continues: bool
    """Whether it compensates while nothing can be stored."""
    period_s: float
    """Of the control."""
    devices: Mapping[str, modbus_nature.Nature]
    """By host."""
    troubles: tuple[Trouble, ...]

    def __str__(self) -> str:
        devices = "; ".join(f"{name}: {nature}" for name, nature in self.devices.items())
        return f"{devices}; {len(self.troubles)} troubles in {self.lasts_s / 3600:.1f} h"


def _control(draw: random.Random) -> Disturbances:
    share = log_uniform(draw, 0.01, 0.5)
    match draw.choice(("drops", "late", "late", "halves", "hangs up", "refuses", "all")):
        case "drops":
            return Disturbances(drops=share)
        case "late":
            return Disturbances(late=share, late_s=log_uniform(draw, 0.1, 30.0))
        case "halves":
            return Disturbances(halves=share)
        case "hangs up":
            return Disturbances(hangs_up=share)
        case "refuses":
            return Disturbances(refuses=True, drops=1.0)
        case _:
            return Disturbances(share / 4, share / 4, 3.0, share / 4, share / 4)


def _device(draw: random.Random) -> modbus_nature.Nature:
    """Read rarely and with patience, and never without any answer, so that its neighbours get most of the time."""
    nature = modbus_nature.drawn(draw)
    return replace(nature, period_s=30.0, timeout_s=_PATIENCE * nature.timeout_s, number="right")


def _disk(draw: random.Random, at_s: float) -> Trouble:
    lasts_s = draw.choice((0.0, log_uniform(draw, 5.0, 900.0), log_uniform(draw, 5.0, 900.0)))
    call = 1 if draw.random() < 0.5 else round(log_uniform(draw, 1.0, 300.0))
    return Trouble(max(0.0, at_s), lasts_s, disk=draw.choice(_ERRNOS), call=call)


def drawn(seed: int) -> Plan:
    """The plan of this seed."""
    draw = random.Random(seed)
    lasts_s = draw.uniform(0.75, 1.5) * 3600.0
    devices = {f"host{number}": _device(draw) for number in range(draw.choice((1, 1, 2)))}
    troubles = list[Trouble]()
    for _ in range(draw.randint(2, 8)):
        at_s, short_s = draw.uniform(0.0, lasts_s - QUIET_S), log_uniform(draw, 5.0, 900.0)
        match draw.choice(("disk", "disk", "control", "control", "control", "clock", "clock", "restart", "restart")):
            case "disk":
                troubles.append(_disk(draw, at_s))
            case "control":
                troubles.append(Trouble(at_s, short_s, control=_control(draw)))
            case "clock":
                jump_s = draw.choice((-1.0, 1.0)) * log_uniform(draw, 1.0, 40_000.0)
                troubles.append(Trouble(at_s, short_s, clock_s=jump_s))
            case _:
                off_s = log_uniform(draw, 1.0, 900.0)
                kind = draw.choice(("stopped", "killed", "power cut", "damaged"))
                troubles.append(Trouble(at_s, off_s, restarts=kind))
                if draw.random() < _FAILS_AT_A_START:
                    troubles.append(_disk(draw, at_s + draw.choice((-1.0, 1.0))))
    return Plan(
        seed, lasts_s, draw.choice(("zero", "hold")), draw.random() < 0.5, draw.choice((15.0, 20.0, 30.0)), devices,
        tuple(sorted(troubles, key=lambda one: one.at_s)),
    )  # fmt: skip
