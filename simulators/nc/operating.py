"""What the operator, the machine data and the part program have set before a program of ours runs."""

from dataclasses import dataclass, field


@dataclass(slots=True)
class Told:
    """What the operator and the machine data say."""

    search: bool = False
    test: bool = False
    simulation: bool = False
    dry_run: bool = False
    transformation: int = 0
    """$P_TRAFO: code of the active transformation; 0 none."""
    carrier: int = 0
    """$P_TC: active tool carrier."""
    metric: bool = True
    """MD10240: its basic system."""
    start_lock: bool = True
    """MD20700: no program starts while an axis is not referenced."""
    length_stays: bool = True
    """MD10760 bit 0 = 0: SUPA leaves the tool's length in force."""
    fluid_group: int = 0
    """Group of auxiliary functions that M7, M8 and M9 are in; 0: in none, so that no variable tells what is on."""
    event: int = 0
    """$P_PROG_EVENT."""
    alarm: int = 0
    """$AC_ALARM_STAT; 0x200: it is only shown."""


@dataclass(slots=True)
class Frames:
    """Offsets of the settable and the programmable frame, each for X, Y, Z, A and C, mm and degrees; the latter is also
    turned about Z."""

    settable: dict[str, tuple[float, ...]] = field(default_factory=dict)
    """By G function."""
    shift: tuple[float, ...] = (0.0,) * 5
    turned: bool = False
    """ROT Z90."""
