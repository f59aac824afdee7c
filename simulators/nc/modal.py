"""Modal G functions: groups, which of them are in force, and what they mean for lengths and feeds.

Numbers of the groups, and of a function within its group ($P_GG), as in the list of G functions of NC Programming,
Programming Manual, 12/2019 (6FC5398-2EP40-0BA0).
"""

from dataclasses import dataclass, field
from typing import Final

from simulators.nc.synchronised import ProgramAlarm

MM_PER_INCH: Final = 25.4
GROUPS: Final[dict[int, tuple[str, ...]]] = {
    1: ("G0", "G1", "G2", "G3", "CIP", "ASPLINE", "BSPLINE", "CSPLINE", "POLY", "G33"),
    6: ("G17", "G18", "G19"),
    7: ("G40", "G41", "G42"),
    8: ("G500", "G54", "G55", "G56", "G57"),
    10: ("G60", "G64", "G641", "G642"),
    12: ("G601", "G602", "G603"),
    13: ("G70", "G71", "G700", "G710"),
    14: ("G90", "G91"),
    15: ("G93", "G94", "G95", "G96", "G97"),
    28: ("WALIMON", "WALIMOF"),
    29: ("DIAMOF", "DIAMON"),
    30: ("COMPOF", "COMPON"),
    47: ("G290", "G291"),
    55: ("RTLION", "RTLIOF"),
}
"""The first ones of each group, in their order."""
PROGRAMMABLE: Final = frozenset(("G1", "G17", "G40", "G60", "G90", "G93", "G94", "G500", "G601", "G710", "DIAMOF"))
"""What a program here may switch."""
_GROUP_OF: Final = {code: group for group, codes in GROUPS.items() for code in codes}


def group_of(code: str) -> int:
    """Raises ProgramAlarm for a function that is not known here."""
    if code not in _GROUP_OF:
        raise ProgramAlarm(f"{code}: not known here")
    return _GROUP_OF[code]


@dataclass(slots=True)
class Modal:
    """What is in force. Raises ProgramAlarm for a function that is not in its group."""

    codes: dict[int, str] = field(default_factory=lambda: {group: codes[0] for group, codes in GROUPS.items()})

    def __post_init__(self) -> None:
        for group, code in self.codes.items():
            if group_of(code) != group:
                raise ProgramAlarm(f"{code}: not in group {group}")

    def switch(self, code: str) -> None:
        self.codes[group_of(code)] = code

    def number(self, group: int) -> int:
        """$P_GG: place in the group, from 1 on. Raises ProgramAlarm for a group that is not known here."""
        if group not in GROUPS:
            raise ProgramAlarm(f"$P_GG[{group}]: not known here")
        return GROUPS[group].index(self.codes[group]) + 1

    def has(self, code: str) -> bool:
        return code in self.codes.values()

    @property
    def length_mm(self) -> float:
        """Length of 1 in a programmed end point, mm."""
        return MM_PER_INCH if self.codes[13] in ("G70", "G700") else 1.0

    def system_mm(self, *, metric: bool) -> float:
        """The same for feeds and system variables, which G70 and G71 leave in the basic system (MD10240 metric)."""
        inch = self.codes[13] == "G700" or (self.codes[13] in ("G70", "G71") and not metric)
        return MM_PER_INCH if inch else 1.0
