"""What a part program consists of, once its text has been read."""

from dataclasses import dataclass, field

from simulators.nc.expressions import Source, Used


@dataclass(frozen=True, slots=True)
class Statement:
    """One block. line: of its text, from 1 on."""

    line: int


@dataclass(frozen=True, slots=True)
class Assign(Statement):
    """Several assignments of one block: name, index, value."""

    parts: tuple[tuple[str, Source | None, Source], ...]


@dataclass(frozen=True, slots=True)
class Words(Statement):
    """A block of addresses: what it switches, where it goes."""

    modal: tuple[str, ...] = ()
    m: tuple[int, ...] = ()
    values: tuple[tuple[str, Source], ...] = ()
    """Addresses with their values: T, D, DL, F, SPOS, MEAS."""
    axes: tuple[tuple[str, Source, bool], ...] = ()
    """Axis, end point, and whether the shortest way there (DC)."""
    machine: bool = False
    """SUPA: in machine coordinates."""


@dataclass(frozen=True, slots=True)
class If(Statement):
    condition: Source
    then: tuple[Statement, ...]
    otherwise: tuple[Statement, ...]
    last: int
    """Line of its ENDIF."""


@dataclass(frozen=True, slots=True)
class For(Statement):
    name: str
    first: Source
    to: Source
    body: tuple[Statement, ...]
    last: int


@dataclass(frozen=True, slots=True)
class Goto(Statement):
    label: str


@dataclass(frozen=True, slots=True)
class Label(Statement):
    name: str


@dataclass(frozen=True, slots=True)
class Word(Statement):
    """STOPRE, RET, M17, M0, WAITS."""

    word: str


@dataclass(frozen=True, slots=True)
class Call(Statement):
    name: str
    arguments: tuple[Source, ...]


@dataclass(frozen=True, slots=True)
class Ask(Statement):
    """GETEXET, GETSELT: a procedure that sets a variable."""

    procedure: str
    variable: str


@dataclass(frozen=True, slots=True)
class Message(Statement):
    text: str


@dataclass(frozen=True, slots=True)
class Action(Statement):
    """A static synchronised action, as it is written."""

    text: str


@dataclass(frozen=True, slots=True)
class Data:
    """A variable: its type, how many, and its first values; count 0: no array."""

    kind: str
    count: int = 0
    first: tuple[Source, ...] = ()


@dataclass(slots=True)
class Program:
    """A program that a control has read."""

    name: str
    parameters: tuple[tuple[str, str], ...] = ()
    """Type and name."""
    saves: bool = False
    external: dict[str, tuple[str, ...]] = field(default_factory=dict)
    """Types of the parameters of each program that it may call with some."""
    local: dict[str, Data] = field(default_factory=dict)
    body: tuple[Statement, ...] = ()
    used: Used = field(default_factory=Used)

    @property
    def own(self) -> set[str]:
        return {*self.local, *(name for _, name in self.parameters)}
