"""Expressions of a part program, with the types and priorities of the language.

Programming Manual 12/2019 (6FC5398-2EP40-0BA0), page 444: NOT; * and /; + and -; B_AND; AND; OR; a comparison binds
weakest, and numbers are equal if they differ by rounding only. Strict: truth values and numbers do not stand for one
another within an expression. Assigning converts: REAL to INT rounds, a number that is not 0 is TRUE.
"""

import math
from collections.abc import Callable
from typing import Final, Protocol

from simulators.nc.synchronised import ProgramAlarm
from simulators.nc.words import AXES, FUNCTIONS, Tokens

Value = float | int | bool | str
"""REAL, INT, BOOL, or the name of an axis."""
_SAME: Final = 1e-12


class Scope(Protocol):
    """Where an expression finds its variables."""

    def read(self, name: str, index: Value | None) -> Value:
        """Raises ProgramAlarm for an unknown name and an index that it does not have."""
        ...


Source = Callable[[Scope], Value]


class Used:
    """Names of variables that a program reads or writes, and the functions that it calls."""

    def __init__(self) -> None:
        self.variables: set[str] = set()


def expression(tokens: Tokens, used: Used) -> Source:
    """Read as far as it goes. Raises ProgramAlarm."""
    left = _or(tokens, used)
    if tokens.peek() in _COMPARE:
        compare, right = _COMPARE[tokens.next()], _or(tokens, used)
        if tokens.peek() in _COMPARE:
            raise ProgramAlarm("a comparison of a comparison: set parentheses")
        first = left
        return lambda scope: compare(_number(first(scope)), _number(right(scope)))
    return left


def converted(value: Value, kind: str) -> Value:
    """As assigning to a variable of this type does."""
    if isinstance(value, str):
        raise ProgramAlarm(f"{value}: an axis where a number is expected")
    if kind == "INT":
        return math.floor(value + 0.5)
    return bool(value) if kind == "BOOL" else float(value)


def _or(tokens: Tokens, used: Used) -> Source:
    left = _and(tokens, used)
    while tokens.accept("OR"):
        left = _either(left, _and(tokens, used))
    return left


def _and(tokens: Tokens, used: Used) -> Source:
    left = _bits(tokens, used)
    while tokens.accept("AND"):
        left = _both(left, _bits(tokens, used))
    return left


def _bits(tokens: Tokens, used: Used) -> Source:
    left = _sum(tokens, used)
    while tokens.accept("B_AND"):
        left = _bitwise(left, _sum(tokens, used))
    return left


def _sum(tokens: Tokens, used: Used) -> Source:
    left = _product(tokens, used)
    while tokens.peek() in ("+", "-"):
        left = _arithmetic(tokens.next(), left, _product(tokens, used))
    return left


def _product(tokens: Tokens, used: Used) -> Source:
    left = _factor(tokens, used)
    while tokens.peek() in ("*", "/"):
        left = _arithmetic(tokens.next(), left, _factor(tokens, used))
    return left


def _factor(tokens: Tokens, used: Used) -> Source:
    token = tokens.next()
    if token == "(":
        inside = expression(tokens, used)
        tokens.expect(")")
        return inside
    if token == "-":
        value = _factor(tokens, used)
        return lambda scope: -_number(value(scope))
    if token == "NOT":
        truth = _factor(tokens, used)
        return lambda scope: not _truth(truth(scope))
    if token in ("TRUE", "FALSE"):
        return _constant(token == "TRUE")
    if token[0].isdigit():
        return _constant(float(token) if "." in token else int(token))
    if tokens.peek() == "(":
        return _function(token, tokens, used)
    if token in AXES:
        return _constant(token)
    return _variable(token, tokens, used)


def _function(name: str, tokens: Tokens, used: Used) -> Source:
    if name not in FUNCTIONS:
        raise ProgramAlarm(f"{name}: not a function that is known here")
    tokens.expect("(")
    arguments = [expression(tokens, used)]
    while tokens.accept(","):
        arguments.append(expression(tokens, used))
    tokens.expect(")")
    expected = 2 if name == "MAXVAL" else 1
    if len(arguments) != expected:
        raise ProgramAlarm(f"{name}: {len(arguments)} arguments, expected {expected}")
    apply = _APPLY[name]
    return lambda scope: apply(*(_number(argument(scope)) for argument in arguments))


def variable(token: str, tokens: Tokens, used: Used) -> tuple[str, Source | None]:
    """Name and index of a variable whose first token has been read; R65 stands for R[65]."""
    if token[0] == "R" and token[1:].isdigit():
        return "R", _constant(int(token[1:]))
    if not (token[0].isalpha() or token[0] in "$_"):
        raise ProgramAlarm(f"{token}: expected a variable")
    if token.startswith("$$"):
        raise ProgramAlarm(f"{token}: only synchronised actions read and write it so")
    used.variables.add(token)
    if not tokens.accept("["):
        return token, None
    index = expression(tokens, used)
    tokens.expect("]")
    return token, index


def _variable(token: str, tokens: Tokens, used: Used) -> Source:
    name, index = variable(token, tokens, used)
    if index is None:
        return lambda scope: scope.read(name, None)
    return lambda scope: scope.read(name, index(scope))


def _constant(value: Value) -> Source:
    return lambda _: value


def _either(left: Source, right: Source) -> Source:
    return lambda scope: _truth(left(scope)) | _truth(right(scope))


def _both(left: Source, right: Source) -> Source:
    return lambda scope: _truth(left(scope)) & _truth(right(scope))


def _bitwise(left: Source, right: Source) -> Source:
    return lambda scope: _whole(left(scope)) & _whole(right(scope))


def _arithmetic(sign: str, left: Source, right: Source) -> Source:
    def value(scope: Scope) -> Value:
        a, b = _number(left(scope)), _number(right(scope))
        if sign == "/":
            if not b:
                raise ProgramAlarm("division by 0")
            return a / b
        return a + b if sign == "+" else a - b if sign == "-" else a * b

    return value


def _number(value: Value) -> float | int:
    if isinstance(value, bool | str):
        raise ProgramAlarm(f"{value}: expected a number; set parentheses around a comparison")
    return value


def _truth(value: Value) -> bool:
    if not isinstance(value, bool):
        raise ProgramAlarm(f"{value}: expected a truth value; AND and OR bind tighter than a comparison")
    return value


def _whole(value: Value) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise ProgramAlarm(f"{value}: expected an INT")
    return value


def _equal(a: float, b: float) -> bool:
    return math.isclose(a, b, rel_tol=_SAME)


_COMPARE: Final[dict[str, Callable[[float, float], bool]]] = {
    "==": _equal,
    "<>": lambda a, b: not _equal(a, b),
    "<=": lambda a, b: a <= b,
    ">=": lambda a, b: a >= b,
    "<": lambda a, b: a < b,
    ">": lambda a, b: a > b,
}
_APPLY: Final[dict[str, Callable[..., Value]]] = {
    "ABS": abs,
    "ROUND": lambda v: math.floor(v + 0.5),
    "MAXVAL": max,
    "SIN": lambda v: math.sin(math.radians(v)),
    "SPI": lambda number: f"S{number}",
}
