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
_TOKEN = re.compile(r"\s*(?:(\d+\.?\d*)|(\$?\$?[A-Z_][A-Z_0-9]*)|(==|<>|<=|>=|[-+*/()<>=\[\],]))")
_COMPARE: Final[Mapping[str, Callable[[float, float], bool]]] = {
    "==": lambda a, b: a == b,
    "<>": lambda a, b: a != b,
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


@dataclass(frozen=True, slots=True)
class _Action:
    condition: TruthSource | None
    assignments: tuple[tuple[list[float], int, NumberSource], ...]


class SynchronisedActions:
    """What one channel evaluates in each interpolation cycle.

    Parameters
    ----------
    variables: by name, without $
    timers: the values of $AC_TIMER; a timer runs from when something is assigned to it
    ipo_s: interpolation cycle, s
    """

    def __init__(self, variables: Mapping[str, SystemVariable], timers: list[float], ipo_s: float) -> None:
        self.ipo_s = ipo_s
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
        passes = True
        for number, line in enumerate(program.splitlines(), 1):
            block = line.split(";")[0].strip()
            try:
                if len(line) > LONGEST_BLOCK:
                    raise ProgramAlarm(f"{len(line)} characters, at most {LONGEST_BLOCK}")
                if block.startswith("IF "):
                    passes = _Parser(block[3:], self._variables, main_run=False).condition()()
                elif block == "ENDIF":
                    passes = True
                elif passes and block in ("RET", "M17"):
                    break
                elif passes:
                    self._run(block)
            except ProgramAlarm as alarm:
                raise ProgramAlarm(f"line {number}: {alarm}: {block}") from None
        self._order = [self._actions[number] for number in self.numbers]

    def cancel(self, number: int) -> None:
        """CANCEL: remove the action. Raises KeyError if there is none."""
        del self._actions[number]
        self._order = [self._actions[number] for number in self.numbers]

    def cycle(self) -> None:
        """One interpolation cycle."""
        for timer in self._running:
            self._timers[timer] += self.ipo_s
        for action in self._order:
            if action.condition is None or action.condition():
                for values, index, value in action.assignments:
                    values[index] = value()
                    if values is self._timers:
                        self._running.add(index)

    def _run(self, block: str) -> None:
        if not block or block in ("STOPRE", "M0") or block.startswith(("PROC ", "MSG(")):
            return
        if re.fullmatch(r"TALC_[A-Z]+", block):
            return  # another program
        found = re.fullmatch(r"IDS=(\d+) (?:(WHENEVER) (.+?) )?DO (.+)", block)
        if found is None:
            for values, index, value in _Parser(block, self._variables, main_run=False).assignments():
                values[index] = value()
            return
        number, word, condition, actions = found.groups()
        if not 1 <= int(number) <= HIGHEST_ID:
            raise ProgramAlarm(f"IDS={number}: expected 1 to {HIGHEST_ID}")
        if int(number) in self._actions:
            raise ProgramAlarm(f"IDS={number} is already defined")
        self._actions[int(number)] = _Action(
            _Parser(condition, self._variables).condition() if word else None,
            tuple(_Parser(actions, self._variables).assignments()),
        )


class _Parser:
    """Recursive descent, by the manual's priorities. Strict: a truth value is not a number, and nothing is
    converted."""

    def __init__(self, text: str, variables: Mapping[str, SystemVariable], *, main_run: bool = True) -> None:
        self._variables, self._main_run = variables, main_run
        self._tokens: list[str] = []
        text, at = text.rstrip(), 0
        while at < len(text):
            found = _TOKEN.match(text, at)
            if found is None:
                raise ProgramAlarm(f"cannot read {text[at:]!r}")
            self._tokens.append(found[found.lastindex or 0])
            at = found.end()
        self._at = 0

    def condition(self) -> TruthSource:
        typed = self._comparison()
        self._end()
        if typed[0] is not bool:
            raise ProgramAlarm("the condition is a number")
        return self._truth(typed)

    def assignments(self) -> list[tuple[list[float], int, NumberSource]]:
        found = []
        while self._at < len(self._tokens):
            values, index = self._variable(self._next(), written=True)
            self._expect("=")
            found.append((values, index, self._number(self._comparison())))
        return found

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
        values, index = self._variable(token)
        return float, lambda: values[index]

    # Words -----------------------------------------------------------------------------------------------------------

    def _variable(self, token: str, *, written: bool = False) -> tuple[list[float], int]:
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
        return variable.values, index

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


def _sum_of(a: NumberSource, b: NumberSource) -> NumberSource:
    return lambda: a() + b()


def _difference(a: NumberSource, b: NumberSource) -> NumberSource:
    return lambda: a() - b()


def _product_of(a: NumberSource, b: NumberSource) -> NumberSource:
    return lambda: a() * b()


def _quotient(a: NumberSource, b: NumberSource) -> NumberSource:
    return lambda: a() / b()
