"""Interprets the synchronised actions of an NC program.

It knows the subset that TALC's programs use, and nothing beyond what the manuals allow there.

What a synchronised action may contain: NC Programming, Programming Manual, 12/2019 (6FC5398-2EP40-0BA0), 2.15.7: the
functions of FUNCTIONS, and the priority of operators, by which a comparison binds weaker than AND and OR. Actions run
in the order of their numbers, in each interpolation cycle; setting data is written by its name with $$ (Job planning,
10.1.3 and 10.3.8).
"""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

HIGHEST_ID: Final = 255
"""Highest id of a synchronised action; the control's display of them has the same number of places."""
LONGEST_BLOCK: Final = 512
"""Characters."""
FUNCTIONS: Final[Mapping[str, Callable[[float], float]]] = {
    "SIN": lambda v: math.sin(math.radians(v)),
    "COS": lambda v: math.cos(math.radians(v)),
    "TAN": lambda v: math.tan(math.radians(v)),
    "SQRT": math.sqrt,
    "ABS": abs,
    "POT": lambda v: v * v,
    "TRUNC": lambda v: float(math.trunc(v)),
}
"""Angles in degrees. MINVAL, MAXVAL and BOUND are functions of part programs, not of synchronised actions."""
MM_PER_INCH: Final = 25.4
_UNITS: Final[Mapping[str, bool]] = {"G70": True, "G71": False, "G700": True, "G710": False}
"""G functions of units, and whether each is inch."""
_TOKEN = re.compile(r"\s*(?:(\d+\.?\d*)|(\$?\$?[A-Z_][A-Z_0-9]*)|(==|<>|<=|>=|[-+*/()<>=\[\],]))")
_SAME: Final = 1e-12
"""Two REALs that differ by less of themselves are equal to == and <>."""
_COMPARE: Final[Mapping[str, Callable[[float, float], bool]]] = {
    "==": lambda a, b: math.isclose(a, b, rel_tol=_SAME),
    "<>": lambda a, b: not math.isclose(a, b, rel_tol=_SAME),
    "<=": lambda a, b: a <= b,
    ">=": lambda a, b: a >= b,
    "<": lambda a, b: a < b,
    ">": lambda a, b: a > b,
}

NumberSource = Callable[[], float]
TruthSource = Callable[[], bool]
Typed = tuple[type, NumberSource]
"""An expression: whether it is a number or a truth (float or bool), and what gives its value."""


class ProgramAlarm(Exception):
    """The control does not take a block of a program."""


@dataclass(frozen=True, slots=True)
class SystemVariable:
    """One variable of the control, or a field of them."""

    values: list[float]
    index: Mapping[str, int] | None = None
    """Index of each axis; None: a number."""
    main_run: str = "$"
    """What precedes its name in a synchronised action."""
    read_only: bool = False
    lengths: range = range(0)
    """Which of them are lengths in mm, and read and written in inches where those are the unit."""


Assignment = tuple[list[float], int, NumberSource]


@dataclass(frozen=True, slots=True)
class _Action:
    condition: TruthSource | None
    assignments: tuple[Assignment, ...]


class SynchronisedActions:
    """What one channel evaluates in each interpolation cycle.

    Parameters
    ----------
    variables: by name, without $
    timers: the values of $AC_TIMER; a timer runs from when a value is assigned to it until a negative one is
    ipo_s: interpolation cycle, s

    Attributes
    ----------
    inch: the program that runs works in inches; so do actions without a G function of their own for it
    protected: MD21240: these numbers are not defined again, cancelled or locked
    """

    def __init__(self, variables: Mapping[str, SystemVariable], timers: list[float], ipo_s: float) -> None:
        self.ipo_s = ipo_s
        self.inch = False
        self.protected = range(0)
        self._timers = timers
        self._running: set[int] = set()
        clock = SystemVariable([ipo_s], read_only=True)
        self._variables = {**variables, "AC_TIMER": SystemVariable(timers), "MN_IPO_CYCLE_TIME": clock}
        self._actions: dict[int, _Action] = {}
        self._order: list[_Action] = []

    @property
    def numbers(self) -> Sequence[int]:
        """Numbers of the actions that are active."""
        return sorted(self._actions)

    def load(self, program: str) -> None:
        """Run a program of assignments, definitions and conditional ends. Raises ProgramAlarm, which names line and
        cause."""
        inch = self.inch
        try:
            self._load(program)
        finally:
            if re.search(r"^PROC \w+ SAVE", program, re.MULTILINE):
                self.inch = inch
            self._order = [self._actions[number] for number in self.numbers]

    def _load(self, program: str) -> None:
        passes = True
        for number, line in enumerate(program.splitlines(), 1):
            block = line.split(";")[0].strip()
            try:
                if len(line) > LONGEST_BLOCK:
                    raise ProgramAlarm(f"{len(line)} characters, at most {LONGEST_BLOCK}")
                if block.startswith("IF "):
                    passes = self._parser(block[3:]).condition()()
                elif block == "ENDIF":
                    passes = True
                elif passes and block in ("RET", "M17"):
                    break
                elif passes:
                    self._run(block)
            except ProgramAlarm as alarm:
                raise ProgramAlarm(f"line {number}: {alarm}: {block}") from None

    def cancel(self, number: int) -> None:
        """CANCEL: remove the action, if there is one. Raises ProgramAlarm for a protected number."""
        self._check_free(number)
        self._actions.pop(number, None)
        self._order = [self._actions[number] for number in self.numbers]

    def cycle(self) -> None:
        """One interpolation cycle."""
        for timer in self._running:
            self._timers[timer] += self.ipo_s
        for action in self._order:
            if action.condition is None or action.condition():
                for assignment in action.assignments:
                    self._assign(*assignment)

    def _assign(self, values: list[float], index: int, source: NumberSource) -> None:
        value = source()
        if values is self._timers and value < 0:
            self._running.discard(index)  # it stops, and keeps what it has counted
            return
        values[index] = value
        if values is self._timers:
            self._running.add(index)

    def _check_free(self, number: int) -> None:
        if number in self.protected and number in self._actions:
            raise ProgramAlarm(f"IDS={number} is protected (MD21240)")

    def _parser(self, text: str, *, main_run: bool = False) -> "_Parser":
        return _Parser(text, self._variables, lambda: self.inch, main_run=main_run)

    def _run(self, block: str) -> None:
        if not block or block in ("STOPRE", "M0") or block.startswith(("PROC ", "MSG(")):
            return
        if re.fullmatch(r"TALC_[A-Z]+", block):
            return  # another program
        if block in _UNITS:
            self.inch = _UNITS[block]
            return
        if found := re.fullmatch(r"CANCEL\((\d+)\)", block):
            self.cancel(int(found[1]))
            return
        found = re.fullmatch(r"IDS?=(\d+) (?:(WHENEVER) (.+?) )?DO (.+)", block)
        if found is None:
            for assignment in self._parser(block).assignments():
                self._assign(*assignment)
            return
        number, word, condition, actions = found.groups()
        if not 1 <= int(number) <= HIGHEST_ID:
            raise ProgramAlarm(f"IDS={number}: expected 1 to {HIGHEST_ID}")
        self._check_free(int(number))
        self._actions[int(number)] = _Action(
            self._parser(condition, main_run=True).condition() if word else None,
            tuple(self._parser(actions, main_run=True).assignments()),
        )


class _Parser:
    """Recursive descent, by the manual's priorities. Strict: a truth value is not a number, and nothing is
    converted."""

    def __init__(
        self, text: str, variables: Mapping[str, SystemVariable], inch: TruthSource, *, main_run: bool
    ) -> None:
        self._variables, self._main_run, self._inch = variables, main_run, inch
        self._tokens: list[str] = []
        text, at = text.rstrip(), 0
        while at < len(text):
            found = _TOKEN.match(text, at)
            if found is None:
                raise ProgramAlarm(f"cannot read {text[at:]!r}")
            self._tokens.append(found[found.lastindex or 0])
            at = found.end()
        self._at = 0
        if main_run and self._peek() in _UNITS:
            own = _UNITS[self._next()]
            self._inch = lambda: own

    def condition(self) -> TruthSource:
        typed = self._comparison()
        self._end()
        if typed[0] is not bool:
            raise ProgramAlarm("the condition is a number")
        return self._truth(typed)

    def assignments(self) -> list[Assignment]:
        found = []
        while self._at < len(self._tokens):
            values, index, is_length = self._variable(self._next(), written=True)
            self._expect("=")
            source = self._number(self._comparison())
            found.append((values, index, _times(source, self._mm_per_unit) if is_length else source))
        return found

    def _mm_per_unit(self) -> float:
        return MM_PER_INCH if self._inch() else 1.0

    # By priority, the weakest first ----------------------------------------------------------------------------------

    def _comparison(self) -> Typed:
        left = self._or()
        if self._peek() in _COMPARE:
            compare = _COMPARE[self._next()]
            a, b = self._number(left), self._number(self._or())
            return bool, lambda: compare(a(), b())
        return left

    def _or(self) -> Typed:
        left = self._and()
        while self._peek() == "OR":
            self._next()
            a, b = self._truth(left), self._truth(self._and())
            left = bool, _either(a, b)
        return left

    def _and(self) -> Typed:
        left = self._sum()
        while self._peek() == "AND":
            self._next()
            a, b = self._truth(left), self._truth(self._sum())
            left = bool, _both(a, b)
        return left

    def _sum(self) -> Typed:
        left = self._product()
        while self._peek() in ("+", "-"):
            plus = self._next() == "+"
            a, b = self._number(left), self._number(self._product())
            left = float, _sum_of(a, b) if plus else _difference(a, b)
        return left

    def _product(self) -> Typed:
        left = self._factor()
        while self._peek() in ("*", "/"):
            times = self._next() == "*"
            a, b = self._number(left), self._number(self._factor())
            left = float, _product_of(a, b) if times else _quotient(a, b)
        return left

    def _factor(self) -> Typed:
        token = self._next()
        if token == "(":
            inside = self._comparison()
            self._expect(")")
            return inside
        if token == "-" and not self._main_run:  # a leading sign
            minus = -float(self._next())
            return float, lambda: minus
        if token[0].isdigit():
            constant = float(token)
            return float, lambda: constant
        if self._peek() == "(":
            if token not in FUNCTIONS:
                raise ProgramAlarm(f"{token}: not a function of synchronised actions")
            self._next()
            function, inside = FUNCTIONS[token], self._comparison()
            self._expect(")")
            argument = self._number(inside)
            return float, lambda: function(argument())
        values, index, is_length = self._variable(token)
        if is_length:
            return float, lambda: values[index] / self._mm_per_unit()
        return float, lambda: values[index]

    # Words -----------------------------------------------------------------------------------------------------------

    def _variable(self, token: str, *, written: bool = False) -> tuple[list[float], int, bool]:
        """What holds the value, where in it, and whether it is a length."""
        if found := re.fullmatch(r"R(\d+)", token):  # R65 stands for R[65], in part programs
            name, text = "R", found[1]
        else:
            name = token.lstrip("$")
            text = "0"
            if self._peek() == "[":
                self._next()
                text = self._next()
                self._expect("]")
        variable = self._variables.get(name)
        if variable is None:
            raise ProgramAlarm(f"{token}: not known")
        if self._main_run and not name.startswith("MN_") and token != variable.main_run + name:
            raise ProgramAlarm(f"{token}: expected {variable.main_run}{name} in a synchronised action")
        if written and variable.read_only:
            raise ProgramAlarm(f"{token} cannot be written")
        try:
            index = int(text) if variable.index is None else variable.index[text]
            variable.values[index]
        except (IndexError, KeyError, ValueError):
            raise ProgramAlarm(f"{token}[{text}]: the control has none") from None
        return variable.values, index, index in variable.lengths

    @staticmethod
    def _number(typed: Typed) -> NumberSource:
        if typed[0] is not float:
            raise ProgramAlarm("a comparison where a number is expected; set parentheses")
        return typed[1]

    @staticmethod
    def _truth(typed: Typed) -> TruthSource:
        if typed[0] is not bool:
            raise ProgramAlarm("a number where a comparison is expected; AND and OR bind tighter: set parentheses")
        return typed[1]  # type: ignore[return-value]

    def _peek(self) -> str:
        return self._tokens[self._at] if self._at < len(self._tokens) else ""

    def _next(self) -> str:
        if self._at >= len(self._tokens):
            raise ProgramAlarm("ends too early")
        self._at += 1
        return self._tokens[self._at - 1]

    def _expect(self, token: str) -> None:
        if (found := self._next()) != token:
            raise ProgramAlarm(f"{found!r}: expected {token!r}")

    def _end(self) -> None:
        if self._at < len(self._tokens):
            raise ProgramAlarm(f"{self._peek()!r}: expected the end")


def _either(a: TruthSource, b: TruthSource) -> TruthSource:
    return lambda: a() or b()


def _both(a: TruthSource, b: TruthSource) -> TruthSource:
    return lambda: a() and b()


def _times(a: NumberSource, factor: NumberSource) -> NumberSource:
    return lambda: a() * factor()


def _sum_of(a: NumberSource, b: NumberSource) -> NumberSource:
    return lambda: a() + b()


def _difference(a: NumberSource, b: NumberSource) -> NumberSource:
    return lambda: a() - b()


def _product_of(a: NumberSource, b: NumberSource) -> NumberSource:
    return lambda: a() * b()


def _quotient(a: NumberSource, b: NumberSource) -> NumberSource:
    return lambda: a() / b()
