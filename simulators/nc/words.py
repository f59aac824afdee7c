"""Words of the SINUMERIK language: tokens of a block, names that a program may give, addresses and keywords.

Names: NC Programming, Programming Manual, 12/2019 (6FC5398-2EP40-0BA0), pages 383 and 491: the first two characters are
letters or underscores, because a letter with a number is an address with its extension (X2); variables have at most 31
characters, programs 24; no keyword, no predefined function or procedure.
"""

import re
from typing import Final

from simulators.nc.synchronised import LONGEST_BLOCK, ProgramAlarm

AXES: Final = ("X", "Y", "Z", "A", "C")
"""Names of the channel's axes; C is a modulo axis."""
LINEAR: Final = AXES[:3]
LONGEST_NAME, LONGEST_PROGRAM_NAME = 31, 24
_TOKEN = re.compile(
    r"\s*(?:(?P<number>\d+\.?\d*)|(?P<text>\"[^\"]*\")|(?P<name>\$?\$?[A-Z_][A-Z_0-9]*)"
    r"|(?P<sign>==|<>|<=|>=|[-+*/()<>=\[\],:]))"
)


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


TYPES: Final = ("INT", "REAL", "BOOL")
KEYWORDS: Final = _words(
    """
    PROC EXTERN DEF CHAN SET SAVE DISPLOF IF ELSE ENDIF FOR TO ENDFOR GOTOF RET STOPRE MSG IDS WHENEVER DO WAITS
    """
)
_ADDRESSES: Final = _words(
    """
    T D DL F MEAS SUPA SPOS SVC DIAMOF DC M G N R S H
    """
)
_OPERATORS: Final = _words(
    """
    NOT AND OR XOR B_AND B_OR B_XOR B_NOT DIV MOD
    """
)
FUNCTIONS: Final = frozenset(("ABS", "ROUND", "MAXVAL", "SIN", "SPI"))
"""Of part programs, as far as they are known here. Angles in degrees."""
PROCEDURES: Final = frozenset(("GETEXET", "GETSELT"))
_PREDEFINED: Final = _words(
    """
    NUMBER ISNUMBER INDEX RINDEX MINDEX STRLEN SUBSTR TOUPPER TOLOWER AXNAME AXSTRING ISAXIS ISVAR ISFILE CASE
    OF DEFAULT WHILE ENDWHILE LOOP ENDLOOP REPEAT UNTIL GOTO GOTOB GOTOC GOTOS CALL PCALL MCALL TRUNC ASIN ACOS
    ATAN2 SQRT POT LN EXP COS TAN MINVAL BOUND TRANS ATRANS ROT AROT SCALE MIRROR TRAORI TRAFOOF TOFRAME TOROT MEAW
    MEASA MEAC STRING CHAR AXIS FRAME VAR SBLOF ID WHEN EVERY FROM CANCEL LOCK UNLOCK RESET SETAL RPY SIG MAX MIN
    SPOSA LIMS TCARR CYCLE CHKDNO GETT GETD SETPIECE DELT NEWT STOPREOF BLOCK PRIO ACTBLOCNO APR APW PUTFTOC FTOCON
    """
)
"""Words that Siemens has taken, none of which is known here: a name, and so no use, for a program of ours."""
RESERVED: Final = KEYWORDS | _ADDRESSES | _OPERATORS | FUNCTIONS | PROCEDURES | _PREDEFINED | {*TYPES, *AXES}


def check_name(name: str, longest: int = LONGEST_NAME) -> None:
    """Raises ProgramAlarm for a name that no variable or program may have."""
    if not re.fullmatch(r"[A-Z_]{2}[A-Z_0-9]*", name):
        raise ProgramAlarm(f"{name}: the first two characters of a name are letters or underscores")
    if len(name) > longest:
        raise ProgramAlarm(f"{name}: {len(name)} characters, at most {longest}")
    if name in RESERVED:
        raise ProgramAlarm(f"{name}: has a meaning in the language")


class Tokens:
    """The tokens of a block, with a place where reading goes on. Raises ProgramAlarm for what is no token."""

    def __init__(self, block: str) -> None:
        if len(block) > LONGEST_BLOCK:
            raise ProgramAlarm(f"{len(block)} characters, at most {LONGEST_BLOCK}")
        self._tokens: list[str] = []
        self._at = at = 0
        block = block.rstrip()
        while at < len(block):
            found = _TOKEN.match(block, at)
            if found is None:
                raise ProgramAlarm(f"cannot read {block[at:]!r}")
            self._tokens.append(found[0].strip())
            at = found.end()

    def peek(self, ahead: int = 0) -> str:
        """The next token, or one behind it; empty at the end."""
        at = self._at + ahead
        return self._tokens[at] if at < len(self._tokens) else ""

    def next(self) -> str:
        if not self.peek():
            raise ProgramAlarm("ends too early")
        self._at += 1
        return self._tokens[self._at - 1]

    def accept(self, token: str) -> bool:
        """Take the next token if it is this one."""
        if self.peek() != token:
            return False
        self._at += 1
        return True

    def expect(self, token: str) -> None:
        if not self.accept(token):
            raise ProgramAlarm(f"{self.peek() or 'the end'}: expected {token}")

    def end(self) -> None:
        if self.peek():
            raise ProgramAlarm(f"{self.peek()}: expected the end of the block")
