"""One channel that runs part programs: blocks are interpreted ahead of the axes, which follow at a preprocessing stop.

Variables of programs, R-parameters and G functions belong to the interpretation; positions, probe, spindle and its tool
to the main run. What a program reads of those before its STOPRE is what was there before its last blocks.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from typing import ClassVar, Final

from simulators.nc import statements as b
from simulators.nc.axes import Axes, Path, Reset
from simulators.nc.blocks import read_global_data, read_program
from simulators.nc.expressions import Value, converted
from simulators.nc.modal import Modal, group_of
from simulators.nc.motion import path_of
from simulators.nc.operating import Frames, Told
from simulators.nc.readings import reading
from simulators.nc.spindle import Spindle
from simulators.nc.synchronised import ProgramAlarm, SystemVariable
from simulators.nc.tools import Tools
from simulators.nc.words import AXES

_R_COUNT: Final = 137
ALARM_SHOWN: Final = 0x200
"""Of $AC_ALARM_STAT: told to the PLC and shown, and nothing stops."""


class _Return(Exception):
    pass


class _Jump(Exception):
    def __init__(self, label: str) -> None:
        super().__init__(label)
        self.label = label


@contextmanager
def _at(place: str) -> Iterator[None]:
    """Adds the place to an alarm."""
    try:
        yield
    except ProgramAlarm as alarm:
        raise alarm if " line " in str(alarm) else ProgramAlarm(f"{place}: {alarm}") from None


def _reset() -> None:
    raise Reset("M0: only RESET ends it here")


@dataclass(slots=True)
class _Variable:
    kind: str
    values: list[Value]
    array: bool


class Channel:
    """Raises ProgramAlarm, with program, line and cause, where a control would stop.

    Parameters
    ----------
    programs: texts of the programs; one that is not valid is refused here
    data: text of the file of global data
    variables: of the control beside those known here, by name without $
    actions: takes each static synchronised action as it is written
    hooks: programs that the machine builder has written, by name: what they do in the main run, with their parameters
    ahead: how many blocks the interpretation may be ahead of the axes; 0: single block
    """

    def __init__(
        self,
        programs: Sequence[str],
        data: str,
        axes: Axes,
        tools: Tools,
        *,
        variables: Mapping[str, SystemVariable] | None = None,
        actions: Callable[[str], None] | None = None,
        hooks: Mapping[str, Callable[..., None]] | None = None,
        ahead: int = 1000,
    ) -> None:
        self.axes, self.tools, self.ahead = axes, tools, ahead
        self.spindle = Spindle(axes)
        self.told, self.modal, self.frames = Told(), Modal(), Frames()
        self.modal.switch("G710")
        self.feed = 0.0
        """F as it was programmed last."""
        self.r = [0.0] * _R_COUNT
        self.written: list[tuple[int, float, dict[str, float], int]] = []
        """Each R-parameter that was written, its value, where the axes and which tool (T) was in the spindle then, and
        how many moves there had been."""
        self.halted: Callable[[], None] = _reset
        """What the operator does at M0; without any, RESET."""
        self.messages: list[str] = []
        self.variables, self.actions, self._hooks = dict(variables or {}), actions, dict(hooks or {})
        self._global = {name: self._made(entry) for name, entry in read_global_data(data).items()}
        self.programs = {program.name: program for program in map(read_program, programs)}
        for program in self.programs.values():
            self._check(program)
        self._stack: list[tuple[b.Program, dict[str, _Variable]]] = []
        self._queue: list[tuple[str, Path | Callable[[], None]]] = []
        self._place = ""
        self._end = dict(axes.position)

    def start(self, name: str) -> None:
        """NC start of a program, or its call by another one; to its end. Raises also Reset."""
        missing = [axis for axis in AXES if not self.axes.homed[axis]]
        if missing and self.told.start_lock:
            raise ProgramAlarm(f"NC start: {missing[0]} is not referenced (MD20700)")
        if self.told.alarm & ~ALARM_SHOWN:
            raise ProgramAlarm("NC start: an alarm stops the program")
        self._end = dict(self.axes.position)
        try:
            self._run(self.programs[name], ())
            self._stop()
        finally:
            self._queue.clear()
            self._stack.clear()

    def reset(self) -> None:
        """What a control does after RESET: its hook calls TALC_RESET with event 3."""
        self.told.event = 3
        self.start("TALC_RESET")
        self.told.event = 0

    def data(self, name: str) -> list[Value]:
        """Values of a global variable, to read and to write."""
        return self._global[name].values

    # Programs -------------------------------------------------------------------------------------------------------

    def _check(self, program: b.Program) -> None:
        for name in program.own & set(self._global):
            raise ProgramAlarm(f"{program.name}: {name} is global data too")
        for name in program.used.variables:
            if name != "R" and name[0] != "$" and name not in program.own and name not in self._global:
                raise ProgramAlarm(f"{program.name}: {name} is not defined")
        for name, kinds in program.external.items():
            called = self.programs.get(name)
            if called is None or tuple(kind for kind, _ in called.parameters) != kinds:
                raise ProgramAlarm(f"{program.name}: EXTERN {name} does not fit")

    def _run(self, program: b.Program, arguments: Sequence[Value]) -> None:
        if len(self._stack) > 10:
            raise ProgramAlarm(f"{program.name}: more than 11 program levels")
        if len(arguments) != len(program.parameters):
            raise ProgramAlarm(f"{program.name}: expected {len(program.parameters)} parameters")
        kept = dict(self.modal.codes), self.frames.shift, self.frames.turned
        given = zip(program.parameters, arguments, strict=True)
        own = {name: _Variable(kind, [converted(value, kind)], False) for (kind, name), value in given}
        self._stack.append((program, own))
        own.update({name: self._made(entry) for name, entry in program.local.items()})
        with suppress(_Return):
            self._body(program.body)
        self._stack.pop()
        if program.saves:
            self._switch(kept[0])
            _, self.frames.shift, self.frames.turned = kept

    def _body(self, statements: Sequence[b.Statement]) -> None:
        """At the top of a program: jumps end here."""
        labels = {s.name: index for index, s in enumerate(statements) if isinstance(s, b.Label)}
        at = 0
        while at < len(statements):
            try:
                self._statement(statements[at])
                at += 1
            except _Jump as jump:
                if labels.get(jump.label, -1) < at:
                    raise ProgramAlarm(f"{self._place}: GOTOF {jump.label}: not further on in this program") from None
                at = labels[jump.label]

    def _statement(self, statement: b.Statement) -> None:
        self._place = place = f"{self._stack[-1][0].name} line {statement.line}"
        with _at(place):
            self._DO[type(statement)](self, statement)

    def _assign(self, statement: b.Assign) -> None:
        for name, index, value in statement.parts:
            self._write(name, None if index is None else index(self), value(self))

    def _word(self, statement: b.Word) -> None:
        if statement.word == "STOPRE":
            if self.modal.codes[7] != "G40":
                raise ProgramAlarm("STOPRE within a contour with radius compensation")
            self._stop()
        elif statement.word == "WAITS":
            self._put(self.spindle.wait)
        elif statement.word == "M0":
            self._stop()
            self.halted()
        else:
            raise _Return

    def _if(self, statement: b.If) -> None:
        truth = statement.condition(self)
        if not isinstance(truth, bool):
            raise ProgramAlarm("the condition is a number")
        for inner in statement.then if truth else statement.otherwise:
            self._statement(inner)

    def _for(self, statement: b.For) -> None:
        now = int(converted(statement.first(self), "INT"))
        self._write(statement.name, None, now)
        while now <= int(converted(statement.to(self), "INT")):
            for inner in statement.body:
                self._statement(inner)
            now = int(converted(self.read(statement.name, None), "INT")) + 1
            self._write(statement.name, None, now)

    def _goto(self, statement: b.Goto) -> None:
        raise _Jump(statement.label)

    def _label(self, _: b.Label) -> None: ...

    def _call(self, statement: b.Call) -> None:
        arguments = [argument(self) for argument in statement.arguments]
        if hook := self._hooks.get(statement.name):
            self._put(lambda: hook(*arguments))
        elif statement.name in self.programs:
            self._run(self.programs[statement.name], arguments)
        else:
            raise ProgramAlarm(f"{statement.name}: no such program")

    def _ask(self, statement: b.Ask) -> None:
        self._write(statement.variable, None, self.tools.asked(statement.procedure))

    def _message(self, statement: b.Message) -> None:
        self.messages.append(statement.text)

    def _action(self, statement: b.Action) -> None:
        if self.actions is None:
            raise ProgramAlarm("no synchronised actions here")
        self._put(partial(self.actions, statement.text))

    # Blocks ---------------------------------------------------------------------------------------------------------

    def _words(self, block: b.Words) -> None:
        self._switch({group_of(code): code for code in block.modal})
        values = {name: value(self) for name, value in block.values}
        if "F" in values:
            self.feed = float(converted(values["F"], "REAL"))
            if self.feed <= 0.0:
                raise ProgramAlarm("14800: F is 0 or less")
        self._spindle_words(values)
        if "T" in values:
            self._put(self.tools.select(int(converted(values["T"], "INT"))))
        for code in block.m:
            self._m(code)
        if "D" in values:
            self.tools.cut(int(converted(values["D"], "INT")))
        if "DL" in values:
            self.tools.sum = int(converted(values["DL"], "INT"))
        if block.axes:
            self._move(block, measures="MEAS" in values)
        elif "MEAS" in values:
            raise ProgramAlarm("a measuring block without a motion")

    def _switch(self, codes: Mapping[int, str]) -> None:
        """G functions come into force; another kind of feed deletes F (V1, 6FC5397-0BP10-0BA0, 2.1)."""
        kind = self.modal.codes[15]
        self.modal.codes.update(codes)
        if self.modal.codes[15] != kind:
            self.feed = 0.0
            self.spindle.left_constant_cutting()

    def _spindle_words(self, values: Mapping[str, Value]) -> None:
        if "SPOS" in values:
            self._put(partial(self.spindle.turn_to, float(converted(values["SPOS"], "REAL"))))
        for word, kind in (("S", 3 if self.modal.codes[15] == "G96" else 1), ("SVC", 2)):
            if word in values:
                self.spindle.programmed(float(converted(values[word], "REAL")), kind)

    def _m(self, code: int) -> None:
        if code == 6:
            change = self.tools.change()
            self.spindle.forget()
            self._put(self.spindle.at_tool_change)
            self._put(change)
        elif code in (3, 4, 5):
            self.spindle.direction = code
            self._put(partial(self.spindle.switch, code))
        else:
            self._put(partial(setattr, self.spindle, "fluid", code))

    def _move(self, block: b.Words, *, measures: bool) -> None:
        path = path_of(block, self, self._end, measures=measures)
        self._end.update(path.end)
        self._put(path)

    # Main run -------------------------------------------------------------------------------------------------------

    def _put(self, entry: Path | Callable[[], None]) -> None:
        self._queue.append((self._place, entry))
        while len(self._queue) > self.ahead:
            self._next()

    def _next(self) -> None:
        place, entry = self._queue.pop(0)
        if self.told.search or self.told.test or self.told.simulation:
            return
        following = self._queue[0][1] if self._queue else None
        with _at(place):
            if isinstance(entry, Path):
                self.axes.run(entry, following if isinstance(following, Path) else None)
            else:
                entry()

    def _stop(self) -> None:
        """A preprocessing stop: everything before it is over."""
        while self._queue:
            self._next()
        self._end = dict(self.axes.position)

    # Variables ------------------------------------------------------------------------------------------------------

    def _made(self, data: b.Data) -> _Variable:
        start = 0.0 if data.kind == "REAL" else False if data.kind == "BOOL" else 0
        first = [converted(value(self), data.kind) for value in data.first]
        values: list[Value] = first if len(first) == max(1, data.count) else (first or [start]) * max(1, data.count)
        return _Variable(data.kind, values, data.count > 0)

    def _found(self, name: str) -> _Variable:
        own = self._stack[-1][1] if self._stack else {}
        found = own.get(name) or self._global.get(name)
        if found is None:
            raise ProgramAlarm(f"{name}: not known")
        return found

    def read(self, name: str, index: Value | None) -> Value:
        """Implements Scope."""
        if name == "R":
            return self.r[self._number(name, index, len(self.r))]
        if name[0] == "$":
            return self._system(name, index)
        variable = self._found(name)
        return variable.values[self._element(name, variable, index)]

    def _write(self, name: str, index: Value | None, value: Value) -> None:
        if name == "R":
            number = self._number(name, index, len(self.r))
            self.r[number] = float(converted(value, "REAL"))
            there = {**self.axes.position, "T": float(self.axes.tool)}
            self.written.append((number, self.r[number], there, len(self.axes.moves)))
        elif name[0] == "$":
            entry, at = self._setting(name, index)
            if entry.read_only:
                raise ProgramAlarm(f"{name} cannot be written")
            entry.values[at] = float(converted(value, "REAL")) * self._unit(entry, at)
        else:
            variable = self._found(name)
            variable.values[self._element(name, variable, index)] = converted(value, variable.kind)

    def _element(self, name: str, variable: _Variable, index: Value | None) -> int:
        if variable.array:
            return self._number(name, index, len(variable.values))
        if index is not None:
            raise ProgramAlarm(f"{name} has no index")
        return 0

    @staticmethod
    def _number(name: str, index: Value | None, count: int) -> int:
        if index is None or isinstance(index, str) or not 0 <= (at := int(converted(index, "INT"))) < count:
            raise ProgramAlarm(f"{name}[{index}]: the control has none")
        return at

    def _system(self, name: str, index: Value | None) -> Value:
        found = reading(self, name, index)
        if found is not None:
            return found
        entry, at = self._setting(name, index)
        return entry.values[at] / self._unit(entry, at)

    def _setting(self, name: str, index: Value | None) -> tuple[SystemVariable, int]:
        entry = self.variables.get(name[1:])
        if entry is None:
            raise ProgramAlarm(f"{name}: not known")
        if entry.index is not None:
            if index not in entry.index:
                raise ProgramAlarm(f"{name}[{index}]: the control has none")
            return entry, entry.index[str(index)]
        return entry, self._number(name, 0 if index is None else index, len(entry.values))

    def _unit(self, entry: SystemVariable, at: int) -> float:
        """mm that 1 is in this program, for a length."""
        return self.modal.system_mm(metric=self.told.metric) if at in entry.lengths else 1.0

    _DO: ClassVar[dict[type[b.Statement], Callable[..., None]]] = {
        b.Assign: _assign,
        b.Words: _words,
        b.Word: _word,
        b.If: _if,
        b.For: _for,
        b.Goto: _goto,
        b.Label: _label,
        b.Call: _call,
        b.Ask: _ask,
        b.Message: _message,
        b.Action: _action,
    }
