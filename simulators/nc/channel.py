"""One channel that runs part programs: blocks are interpreted ahead of the axes, which follow at a preprocessing stop.

Variables of programs, R-parameters and G functions belong to the interpretation; positions, probe, spindle and tool in the
spindle to the main run. What a program reads of those before its STOPRE is what was there before its last blocks.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from simulators.nc import blocks as b
from simulators.nc.axes import Axes, Path, Reset
from simulators.nc.expressions import Value, converted
from simulators.nc.modal import MM_PER_INCH, Modal, group_of
from simulators.nc.synchronised import ProgramAlarm, SystemVariable
from simulators.nc.tools import Tools
from simulators.nc.words import AXES

LINEAR = AXES[:3]
_ROTARY = AXES[3:]
DRY_RUN_FEED = 5000.0
"""SD42100, mm/min: what dry run makes of every feed."""
_LENGTHS = frozenset({"SA_TEMP_COMP_ABS_VALUE"})
"""Setting data that is a length: a program sees it in its own unit."""
_R_COUNT = 130


@dataclass(slots=True)
class Told:
    """What the operator and the machine data say. mirror of BOOL variables of the same meaning."""

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
    event: int = 0
    """$P_PROG_EVENT."""
    alarm: int = 0
    """$AC_ALARM_STAT."""


@dataclass(slots=True)
class Frames:
    """Offsets of the settable and the programmable frame, mm; the latter is also turned about Z."""

    settable: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    """By G function."""
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turned: bool = False
    """ROT Z90."""


class _Return(Exception):
    pass


class _Jump(Exception):
    def __init__(self, label: str) -> None:
        super().__init__(label)
        self.label = label


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
        self.told, self.modal, self.frames = Told(), Modal(), Frames()
        self.modal.switch("G710")
        self.feed = 0.0
        """F as it was programmed last."""
        self.r = [0.0] * _R_COUNT
        self.written: list[tuple[int, float, dict[str, float], int]] = []
        """Each R-parameter that was written, its value, where the axes were then, and how many moves there had been."""
        self.messages: list[str] = []
        self._variables, self._actions, self._hooks = dict(variables or {}), actions, dict(hooks or {})
        self._global = {name: self._made(entry) for name, entry in b.read_global_data(data).items()}
        self.programs = {program.name: program for program in map(b.read_program, programs)}
        for program in self.programs.values():
            self._check(program)
        self._stack: list[tuple[b.Program, dict[str, _Variable]]] = []
        self._queue: list[Path | Callable[[], None]] = []
        self._end = dict(axes.position)

    def start(self, name: str) -> None:
        """NC start of a program, or its call by another one; to its end. Raises also Reset."""
        missing = [axis for axis in AXES if not self.axes.homed[axis]]
        if missing and self.told.start_lock:
            raise ProgramAlarm(f"NC start: {missing[0]} is not referenced (MD20700)")
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
        try:
            self._body(program.body)
        except _Return:
            pass
        self._stack.pop()
        if program.saves:
            self._switch(kept[0])
            _, self.frames.shift, self.frames.turned = kept

    def _call(self, name: str, arguments: list[Value]) -> None:
        if name in self._hooks:
            self._put(lambda: self._hooks[name](*arguments))
        elif name in self.programs:
            self._run(self.programs[name], arguments)
        else:
            raise ProgramAlarm(f"{name}: no such program")

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
                    raise self._alarm(statements[at], f"GOTOF {jump.label}: not further on in this program") from None
                at = labels[jump.label]

    def _statement(self, statement: b.Statement) -> None:
        try:
            self._do(statement)
        except ProgramAlarm as alarm:
            raise self._alarm(statement, str(alarm)) from None

    def _alarm(self, statement: b.Statement, cause: str) -> ProgramAlarm:
        place = f"{self._stack[-1][0].name} line {statement.line}" if self._stack else ""
        return ProgramAlarm(cause if " line " in cause else f"{place}: {cause}")

    def _do(self, statement: b.Statement) -> None:
        match statement:
            case b.Assign(parts=parts):
                for name, index, value in parts:
                    self._write(name, None if index is None else index(self), value(self))
            case b.Words():
                self._words(statement)
            case b.Word(word=word):
                self._word(word)
            case b.If(condition=condition, then=then, otherwise=otherwise):
                truth = condition(self)
                if not isinstance(truth, bool):
                    raise ProgramAlarm("the condition is a number")
                for inner in then if truth else otherwise:
                    self._statement(inner)
            case b.For(name=name, first=first, to=to, body=body):
                self._write(name, None, first(self))
                while (now := self.read(name, None)) <= to(self):  # type: ignore[operator]
                    for inner in body:
                        self._statement(inner)
                    self._write(name, None, now + 1)  # type: ignore[operator]
            case b.Goto(label=label):
                raise _Jump(label)
            case b.Call(name=name, arguments=arguments):
                self._call(name, [argument(self) for argument in arguments])
            case b.Ask(procedure=procedure, variable=variable):
                self._write(variable, None, self.tools.asked(procedure))
            case b.Message(text=text):
                self.messages.append(text)
            case b.Action(text=text):
                if self._actions is None:
                    raise ProgramAlarm("no synchronised actions here")
                self._actions(text)

    def _word(self, word: str) -> None:
        if word == "STOPRE":
            if self.modal.codes[7] != "G40":
                raise ProgramAlarm("STOPRE within a contour with radius compensation")
            self._stop()
        elif word == "M0":
            self._stop()
            raise Reset("M0: only RESET ends it here")
        else:
            raise _Return

    # Blocks ---------------------------------------------------------------------------------------------------------

    def _words(self, block: b.Words) -> None:
        self._switch({group_of(code): code for code in block.modal})
        values = {name: value(self) for name, value in block.values}
        if "F" in values:
            self.feed = float(converted(values["F"], "REAL"))
            if self.feed <= 0.0:
                raise ProgramAlarm("14800: F is 0 or less")
        if "SPOS" in values:
            self._put(self._positioned)
        if "T" in values:
            self._put(self.tools.select(int(converted(values["T"], "INT"))))
        for m in block.m:
            self._put(self.tools.change() if m == 6 else self._stopped if m == 5 else self._dry)
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

    def _positioned(self) -> None:
        self.axes.spindle = "in position"

    def _stopped(self) -> None:
        self.axes.spindle = "stands"

    def _dry(self) -> None:
        self.axes.coolant = False

    def _move(self, block: b.Words, *, measures: bool) -> None:
        if self.told.transformation or self.told.carrier or self.modal.has("G291") or self.modal.codes[7] != "G40":
            raise ProgramAlarm("a motion with a transformation, in ISO language or in a compensated contour")
        if self.modal.codes[1] != "G1":
            raise ProgramAlarm(f"a motion with {self.modal.codes[1]}: not known here")
        end, shortest = dict[str, float](), set[str]()
        for axis, source, direct in block.axes:
            value = float(converted(source(self), "REAL"))
            if axis in LINEAR:
                value *= self.modal.length_mm(self.told.metric)
                if axis == "X" and self.modal.has("DIAMON"):
                    value /= 2.0
            if direct:
                if axis != "C":
                    raise ProgramAlarm(f"{axis}: DC is for modulo axes")
                shortest.add(axis)
            elif self.modal.has("G91"):
                end[axis] = self._end[axis] + value
                continue
            end[axis] = value
        if not self.modal.has("G91"):
            self._from_workpiece(end, machine=block.machine)
        feed = self._feed(end)
        exact = self.modal.has("G60") and self.modal.has("G601")
        self._end.update(end)
        self._put(Path(end, frozenset(shortest), feed, measures, exact, dict(self.modal.codes)))

    def _from_workpiece(self, end: dict[str, float], *, machine: bool) -> None:
        """Frames, and the length of the tool whose edge is in force: from programmed end points to the axes'."""
        if not machine:
            if self.frames.turned and {"X", "Y"} <= end.keys():
                end["X"], end["Y"] = -end["Y"], end["X"]
            settable = self.frames.settable.get(self.modal.codes[8], (0.0, 0.0, 0.0))
            for axis, one, two in zip(LINEAR, settable, self.frames.shift, strict=True):
                if axis in end:
                    end[axis] += one + two
        axis = {"G17": "Z", "G18": "Y", "G19": "X"}[self.modal.codes[6]]
        if axis in end and (self.told.length_stays or not machine):
            end[axis] += self.tools.length_mm

    def _feed(self, end: Mapping[str, float]) -> float:
        """mm/min, or degrees/min. Raises ProgramAlarm without one."""
        if not self.feed:
            raise ProgramAlarm("10860: no feed is programmed")
        if self.told.dry_run:
            return DRY_RUN_FEED
        scale = self.modal.system_mm(self.told.metric) if set(end) & set(LINEAR) else 1.0
        if not self.modal.has("G94"):
            raise ProgramAlarm(f"a feed with {self.modal.codes[15]}: not known here")
        return self.feed * scale

    # Main run -------------------------------------------------------------------------------------------------------

    def _put(self, entry: Path | Callable[[], None]) -> None:
        self._queue.append(entry)
        while len(self._queue) > self.ahead:
            self._next()

    def _next(self) -> None:
        entry = self._queue.pop(0)
        if self.told.search or self.told.test or self.told.simulation:
            return
        if isinstance(entry, Path):
            following = self._queue[0] if self._queue else None
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
            return self.r[self._place(name, index, len(self.r))]
        if name[0] == "$":
            return self._system(name, index)
        variable = self._found(name)
        return variable.values[self._place(name, index, len(variable.values)) if variable.array else _single(name, index)]

    def _write(self, name: str, index: Value | None, value: Value) -> None:
        if name == "R":
            number = self._place(name, index, len(self.r))
            self.r[number] = float(converted(value, "REAL"))
            self.written.append((number, self.r[number], dict(self.axes.position), len(self.axes.moves)))
        elif name[0] == "$":
            entry, at = self._setting(name, index)
            if entry.read_only:
                raise ProgramAlarm(f"{name} cannot be written")
            entry.values[at] = float(converted(value, "REAL")) * self._unit(name)
        else:
            variable = self._found(name)
            at = self._place(name, index, len(variable.values)) if variable.array else _single(name, index)
            variable.values[at] = converted(value, variable.kind)

    @staticmethod
    def _place(name: str, index: Value | None, count: int) -> int:
        if index is None or isinstance(index, str) or not 0 <= (at := int(converted(index, "INT"))) < count:
            raise ProgramAlarm(f"{name}[{index}]: the control has none")
        return at

    def _system(self, name: str, index: Value | None) -> Value:
        if name in _AXIS_VALUES:
            if index not in AXES:
                raise ProgramAlarm(f"{name}[{index}]: expected an axis")
            return _AXIS_VALUES[name](self, str(index))
        if name in _NUMBERED_VALUES:
            return _NUMBERED_VALUES[name](self, int(converted(index if index is not None else 0, "INT")))
        if name in _VALUES:
            _single(name, index)
            return _VALUES[name](self)
        entry, at = self._setting(name, index)
        return entry.values[at] / self._unit(name)

    def _setting(self, name: str, index: Value | None) -> tuple[SystemVariable, int]:
        entry = self._variables.get(name[1:])
        if entry is None:
            raise ProgramAlarm(f"{name}: not known")
        if entry.index is not None:
            if index not in entry.index:
                raise ProgramAlarm(f"{name}[{index}]: the control has none")
            return entry, entry.index[str(index)]
        return entry, self._place(name, 0 if index is None else index, len(entry.values))

    def _unit(self, name: str) -> float:
        """Unit of the program over that of the basic system, for a length."""
        if name[1:] not in _LENGTHS:
            return 1.0
        basic = 1.0 if self.told.metric else MM_PER_INCH
        return self.modal.system_mm(self.told.metric) / basic

    def place(self, axis: str, position: Mapping[str, float]) -> float:
        """A position as a system variable shows it: C within a turn, lengths in the program's unit."""
        value = position[axis]
        if axis == "C":
            return value % 360.0
        return value / self.modal.system_mm(self.told.metric) if axis in LINEAR else value


def _single(name: str, index: Value | None) -> int:
    if index is not None:
        raise ProgramAlarm(f"{name} has no index")
    return 0


_AXIS_VALUES: dict[str, Callable[[Channel, str], Value]] = {
    "$AA_IM": lambda c, axis: c.place(axis, c.axes.position),
    "$AA_MM": lambda c, axis: c.place(axis, c.axes.latched),
    "$AA_REF": lambda c, axis: int(c.axes.homed[axis]),
}
_NUMBERED_VALUES: dict[str, Callable[[Channel, int], Value]] = {
    "$P_GG": lambda c, group: c.modal.number(group),
    "$A_PROBE": lambda c, _: int(c.axes.deflected),
    "$AC_MEA": lambda c, _: c.axes.triggered,
}
_VALUES: dict[str, Callable[[Channel], Value]] = {
    "$P_SIM": lambda c: c.told.simulation,
    "$P_SEARCH": lambda c: c.told.search,
    "$P_ISTEST": lambda c: c.told.test,
    "$P_DRYRUN": lambda c: c.told.dry_run,
    "$P_TRAFO": lambda c: c.told.transformation,
    "$P_TC": lambda c: c.told.carrier,
    "$P_PROG_EVENT": lambda c: c.told.event,
    "$AC_ALARM_STAT": lambda c: c.told.alarm,
    "$P_F": lambda c: c.feed,
    "$P_TOOL": lambda c: c.tools.edge,
    "$P_DLNO": lambda c: c.tools.sum,
    "$P_TOOLNO": lambda c: c.tools.number,
    "$P_TOOLP": lambda c: c.tools.programmed,
    "$MC_TOOL_CHANGE_MODE": lambda c: c.tools.mode,
    "$MC_CUTTING_EDGE_DEFAULT": lambda c: c.tools.default,
    "$MC_TOOL_MANAGEMENT_MASK": lambda c: int(c.tools.managed),
}
