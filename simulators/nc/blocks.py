"""A part program as statements: what a control makes of its text before it runs.

A block that is not known, a word in the wrong place and a name that Siemens rules out are refused with their line.
"""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import ClassVar, Final

from simulators.nc.expressions import Source, Used, expression, variable
from simulators.nc.modal import PROGRAMMABLE
from simulators.nc.statements import (
    Action,
    Ask,
    Assign,
    Call,
    Data,
    For,
    Goto,
    If,
    Label,
    Message,
    Program,
    Statement,
    Word,
    Words,
)
from simulators.nc.synchronised import ProgramAlarm
from simulators.nc.words import AXES, LONGEST_PROGRAM_NAME, PROCEDURES, TYPES, Tokens, check_name

_NUMBERED = re.compile(r"([GMD])(\d+)")
M_CODES: Final = frozenset({3, 4, 5, 6, 7, 8, 9})
"""Spindle, tool change, cutting fluid."""
_VALUED: Final = ("T", "D", "DL", "F", "MEAS", "SPOS", "S", "SVC")


def read_program(text: str) -> Program:
    """Raises ProgramAlarm, which names line and cause."""
    return _Reader(text).program()


def read_global_data(text: str) -> dict[str, Data]:
    """The definitions of a GUD file: its header, DEF CHAN, M30. Raises ProgramAlarm."""
    lines = text.splitlines()
    if len(lines) < 2 or lines[0] != "%_N_MGUD_DEF" or lines[1] != ";$PATH=/_N_DEF_DIR":
        raise ProgramAlarm("line 1: expected %_N_MGUD_DEF, and ;$PATH=/_N_DEF_DIR in line 2")
    found: dict[str, Data] = {}
    blocks = list(_blocks("\n".join(["", "", *lines[2:]])))
    for number, block in blocks[:-1]:
        with _line(number, block):
            tokens = Tokens(block)
            tokens.expect("DEF")
            tokens.expect("CHAN")
            for name, data in _definitions(tokens, Used()):
                if name in found:
                    raise ProgramAlarm(f"{name} is defined twice")
                found[name] = data
    if not blocks or blocks[-1][1] != "M30":
        raise ProgramAlarm("the last block is not M30")
    return found


@contextmanager
def _line(number: int, block: str) -> Iterator[None]:
    """Adds the place to an alarm."""
    try:
        yield
    except ProgramAlarm as alarm:
        raise alarm if str(alarm).startswith("line ") else ProgramAlarm(f"line {number}: {alarm}: {block}") from None


def _blocks(text: str) -> Iterator[tuple[int, str]]:
    """Line and text of each block, without comments."""
    for number, line in enumerate(text.splitlines(), 1):
        block = re.sub(r';[^"]*$|;(?=(?:[^"]*"[^"]*")*[^"]*$).*', "", line).strip()
        if block:
            yield number, block


class _Reader:
    def __init__(self, text: str) -> None:
        self._blocks = list(_blocks(text))
        self._at = 0
        self._program = Program("")

    def program(self) -> Program:
        if not self._blocks:
            raise ProgramAlarm("line 1: an empty program")
        self._head()
        while self._peek().split(" ")[0] in ("EXTERN", "DEF"):
            number, block = self._take()
            with _line(number, block):
                self._define(Tokens(block))
        self._program.body = self._until()
        last = self._program.body[-1] if self._program.body else None
        if not (isinstance(last, Word) and last.word in ("RET", "M17")):
            raise ProgramAlarm(f"line {self._blocks[-1][0]}: expected RET or M17 at the end")
        return self._program

    def _head(self) -> None:
        number, block = self._take()
        with _line(number, block):
            tokens = Tokens(block)
            tokens.expect("PROC")
            self._program.name = name = tokens.next()
            check_name(name, LONGEST_PROGRAM_NAME)
            parameters = []
            if tokens.accept("("):
                while not tokens.accept(")"):
                    kind, parameter = _type(tokens), tokens.next()
                    check_name(parameter)
                    parameters.append((kind, parameter))
                    tokens.accept(",")
            self._program.parameters = tuple(parameters)
            self._program.saves = tokens.accept("SAVE")
            tokens.accept("DISPLOF")
            tokens.end()

    def _define(self, tokens: Tokens) -> None:
        if tokens.next() == "EXTERN":
            name = tokens.next()
            tokens.expect("(")
            kinds = [_type(tokens)]
            while tokens.accept(","):
                kinds.append(_type(tokens))
            tokens.expect(")")
            tokens.end()
            self._program.external[name] = tuple(kinds)
            return
        for name, data in _definitions(tokens, self._program.used):
            if name in self._program.own:
                raise ProgramAlarm(f"{name} is defined twice")
            self._program.local[name] = data

    def _until(self, *ends: str) -> tuple[Statement, ...]:
        """Statements up to one of these words, which stays; nested ones included."""
        found: list[Statement] = []
        while self._at < len(self._blocks) and self._peek() not in ends:
            number, block = self._take()
            with _line(number, block):
                found.append(self._statement(number, block))
        if ends and not self._peek():
            raise ProgramAlarm(f"line {self._blocks[-1][0]}: expected {ends[-1]}")
        return tuple(found)

    def _statement(self, number: int, block: str) -> Statement:
        tokens, used = Tokens(block), self._program.used
        word = tokens.peek()
        if word in self._READ:
            found = self._READ[word](self, number, tokens)
        elif tokens.peek(1) == ":":
            check_name(tokens.next())
            tokens.next()
            found = Label(number, word)
        elif word == "IDS":
            return Action(number, block)
        elif _is_address(tokens):
            return _words(number, tokens, used)
        elif _is_call(tokens):
            found = self._call(number, tokens)
        else:
            return _assign(number, tokens, used)
        tokens.end()
        return found

    def _word(self, number: int, tokens: Tokens) -> Word:
        return Word(number, tokens.next())

    def _goto(self, number: int, tokens: Tokens) -> Goto:
        tokens.next()
        return Goto(number, tokens.next())

    def _message(self, number: int, tokens: Tokens) -> Message:
        tokens.next()
        tokens.expect("(")
        text = tokens.next()
        if not text.startswith('"'):
            raise ProgramAlarm(f"{text}: expected a text")
        tokens.expect(")")
        return Message(number, text[1:-1])

    def _ask(self, number: int, tokens: Tokens) -> Ask:
        procedure = tokens.next()
        tokens.expect("(")
        name = tokens.next()
        self._program.used.variables.add(name)
        tokens.expect(")")
        return Ask(number, procedure, name)

    def _if(self, number: int, tokens: Tokens) -> If:
        tokens.next()
        condition = expression(tokens, self._program.used)
        tokens.end()
        then = self._until("ELSE", "ENDIF")
        otherwise: tuple[Statement, ...] = ()
        if self._peek() == "ELSE":
            self._take()
            otherwise = self._until("ENDIF")
        return If(number, condition, then, otherwise, self._take()[0])

    def _for(self, number: int, tokens: Tokens) -> For:
        tokens.next()
        name = tokens.next()
        self._program.used.variables.add(name)
        tokens.expect("=")
        first = expression(tokens, self._program.used)
        tokens.expect("TO")
        to = expression(tokens, self._program.used)
        tokens.end()
        body = self._until("ENDFOR")
        return For(number, name, first, to, body, self._take()[0])

    def _call(self, number: int, tokens: Tokens) -> Call:
        name, arguments = tokens.next(), list[Source]()
        if tokens.accept("("):
            arguments.append(expression(tokens, self._program.used))
            while tokens.accept(","):
                arguments.append(expression(tokens, self._program.used))
            tokens.expect(")")
            if len(arguments) != len(self._program.external.get(name, ())):
                raise ProgramAlarm(f"{name}: no EXTERN with {len(arguments)} parameters")
        return Call(number, name, tuple(arguments))

    def _peek(self) -> str:
        return self._blocks[self._at][1] if self._at < len(self._blocks) else ""

    def _take(self) -> tuple[int, str]:
        self._at += 1
        return self._blocks[self._at - 1]

    _READ: ClassVar[dict[str, Callable[..., Statement]]] = {
        "IF": _if,
        "FOR": _for,
        "GOTOF": _goto,
        "MSG": _message,
        **dict.fromkeys(PROCEDURES, _ask),
        **dict.fromkeys(("STOPRE", "RET", "M17", "M0", "WAITS"), _word),
    }


def _type(tokens: Tokens) -> str:
    if (kind := tokens.next()) not in TYPES:
        raise ProgramAlarm(f"{kind}: expected a type")
    return kind


def _definitions(tokens: Tokens, used: Used) -> Iterator[tuple[str, Data]]:
    """Of one DEF: a type, then names with their sizes and first values."""
    tokens.accept("DEF")
    kind = _type(tokens)
    while True:
        name, count, first = tokens.next(), 0, list[Source]()
        check_name(name)
        if tokens.accept("["):
            count = int(tokens.next())
            tokens.expect("]")
        if tokens.accept("="):
            several = tokens.accept("SET")
            if several:
                tokens.expect("(")
            first.append(expression(tokens, used))
            while several and tokens.accept(","):
                first.append(expression(tokens, used))
            if several:
                tokens.expect(")")
            if len(first) not in (1, count):
                raise ProgramAlarm(f"{name}: {len(first)} values for {count}")
        yield name, Data(kind, count, tuple(first))
        if not tokens.accept(","):
            break
    tokens.end()


def _is_address(tokens: Tokens) -> bool:
    word = tokens.peek()
    with_value = tokens.peek(1) == "=" and word in (*AXES, *_VALUED)
    return with_value or word in ("SUPA", "DIAMOF") or _NUMBERED.fullmatch(word) is not None


def _is_call(tokens: Tokens) -> bool:
    return tokens.peek()[0].isalpha() and tokens.peek(1) in ("", "(")


def _words(number: int, tokens: Tokens, used: Used) -> Words:
    modal, m, machine = list[str](), list[int](), False
    values, axes = list[tuple[str, Source]](), list[tuple[str, Source, bool]]()
    while tokens.peek():
        word = tokens.next()
        numbered = _NUMBERED.fullmatch(word)
        if word == "SUPA":
            machine = True
        elif word == "DIAMOF" or (numbered and numbered[1] == "G"):
            modal.append(_programmable(word))
        elif numbered and numbered[1] == "M":
            m.append(_m_code(int(numbered[2])))
        elif numbered:
            values.append((numbered[1], _fixed(int(numbered[2]))))
        elif word in AXES:
            tokens.expect("=")
            shortest = tokens.accept("DC")
            axes.append((word, expression(tokens, used), shortest))
        elif word in _VALUED:
            tokens.expect("=")
            values.append((word, expression(tokens, used)))
        else:
            raise ProgramAlarm(f"{word}: not known here")
    named = [*(name for name, _ in values), *(axis for axis, _, _ in axes)]
    if len(set(named)) < len(named):
        raise ProgramAlarm("an address twice in one block")
    return Words(number, tuple(modal), tuple(m), tuple(values), tuple(axes), machine)


def _m_code(value: int) -> int:
    if value not in M_CODES:
        raise ProgramAlarm(f"M{value}: not known here")
    return value


def _programmable(code: str) -> str:
    if code not in PROGRAMMABLE:
        raise ProgramAlarm(f"{code}: not known here")
    return code


def _fixed(value: int) -> Source:
    return lambda _: value


def _assign(number: int, tokens: Tokens, used: Used) -> Assign:
    parts = []
    while tokens.peek():
        name, index = variable(tokens.next(), tokens, used)
        tokens.expect("=")
        parts.append((name, index, expression(tokens, used)))
    return Assign(number, tuple(parts))
