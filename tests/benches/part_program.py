"""Runs the part programs of deploy/nc/sinumerik on a machine that has axes, a table, a sphere and a touch probe.

It translates the words that these programs use, by our reading of the manual, into Python, and refuses every other
word. It is no control: a block is over when the axes are there, and the moves of a block are straight.
"""

import math
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

FOLDER = Path(__file__).parents[2] / "deploy" / "nc" / "sinumerik"
_EXPRESSION = (
    (r"<>", "!="), (r"\bAND\b", "and"), (r"\bOR\b", "or"), (r"\bNOT\b", "not"), (r"\$", "system."),
    (r"\bR(\d+)\b", r"R[\1]"),
)  # fmt: skip
_AXIS_WORD = re.compile(r"\b([XYZAC]|F)=(.+?)(?= [XYZAC]=| F=|$)")
_LENGTH_MM = 150.0
"""The length of every tool."""
_STEP = 1.0
"""The distance between two looks at a moving axis, mm or degrees."""


class Collision(Exception):
    """The probe, or what it stands on, was in the way of a move that is no touch."""


class _Jump(Exception):
    """GOTOF."""


class ProbedMachine:
    """Coordinates are measured from where A and C meet, mm and degrees; the tip is what moves.

    sphere_mm: its centre at A = C = 0; table_mm: radius of the table, whose top is at that height 0; contact_mm:
    distance of tip and centre at which the probe switches
    """

    def __init__(self, sphere_mm: tuple[float, float, float], table_mm: float, contact_mm: float) -> None:
        self._sphere, self._table, self._contact = np.array(sphere_mm), table_mm, contact_mm
        self.at = {"X": 30.0, "Y": -40.0, "Z": 400.0, "A": 0.0, "C": 0.0}
        self.tool, self.present = 3, True
        """Number of the tool in the spindle; whether the sphere is there."""

    def centre(self, a_deg: float, c_deg: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        """(3,) where the sphere is: Rx(a) Rz(c)."""
        (ca, sa), (cc, sc) = ((math.cos(math.radians(v)), math.sin(math.radians(v))) for v in (a_deg, c_deg))
        x, y, z = self._sphere
        x, y = cc * x - sc * y, sc * x + cc * y
        return np.array([x, ca * y - sa * z, sa * y + ca * z])

    def move(self, to: Mapping[str, float], *, touching: bool = False) -> bool:
        """All axes together; whether a touching move met the sphere, where it then ends. Raises Collision."""
        start = dict(self.at)
        steps = max(1, math.ceil(max(abs(to[axis] - start[axis]) for axis in to) / _STEP))
        for step in range(1, steps + 1):
            now = start | {axis: start[axis] + (to[axis] - start[axis]) * step / steps for axis in to}
            near = self._contact - self._distance(now)
            if near > 1e-6 and touching:
                self.at = self._first_contact(self.at, now)
                return True
            if near > 1e-6 or self._in_table(now):
                raise Collision(f"{'sphere' if near > 0 else 'table'} at {now}, on the way from {start} to {to}")
            self.at = now
        return False

    def _distance(self, at: Mapping[str, float]) -> float:
        if not self.present:
            return math.inf
        return float(np.linalg.norm(np.array([at[axis] for axis in "XYZ"]) - self.centre(at["A"], at["C"])))

    def _first_contact(self, clear: Mapping[str, float], inside: Mapping[str, float]) -> dict[str, float]:
        low, high = 0.0, 1.0
        for _ in range(50):
            middle = (low + high) / 2.0
            between = {axis: v + middle * (inside[axis] - v) for axis, v in clear.items()}
            low, high = (middle, high) if self._distance(between) > self._contact else (low, middle)
        return {axis: v + low * (inside[axis] - v) for axis, v in clear.items()}

    def _in_table(self, at: Mapping[str, float]) -> bool:
        ca, sa = math.cos(math.radians(at["A"])), math.sin(math.radians(at["A"]))
        height = ca * at["Z"] - sa * at["Y"]
        return -100.0 < height < 0.0 and math.hypot(at["X"], ca * at["Y"] + sa * at["Z"]) < self._table


class RParameters(list[float]):
    """R0 to R129; notes what was written and where the axes were then."""

    def __init__(self, machine: ProbedMachine) -> None:
        super().__init__([0.0] * 130)
        self._machine = machine
        self.written: list[tuple[int, float, dict[str, float]]] = []

    def __setitem__(self, number: Any, value: Any) -> None:
        self.written.append((number, value, dict(self._machine.at)))
        super().__setitem__(number, value)


class PartPrograms:
    """TALC_SAFE_POINT and what it calls, on one machine.

    A tool change selects the tool's first edge (MD20270). While an edge is in force, positions are those of the tool's
    tip, with SUPA too; without one they are the axis', as it was taught with the probe.

    data: of TALC_GUD.DEF, by name, in place of what stands there
    """

    def __init__(self, machine: ProbedMachine, data: Mapping[str, Any]) -> None:
        self.machine, self.r = machine, RParameters(machine)
        self.lost: set[int] = set()
        """Tools that the magazine does not have."""
        self._system = SimpleNamespace(
            AC_ALARM_STAT=0, AC_TIMER=[0.0] * 3, AC_MEA=[False] * 2, AA_MM=dict.fromkeys("XYZ", 0.0),
            P_TOOLNO=machine.tool, P_TOOL=2,
        )  # fmt: skip
        self._chosen = machine.tool
        self._names: dict[str, Any] = {
            "R": self.r, "system": self._system, "X": "X", "Y": "Y", "Z": "Z", "ABS": abs, "MAXVAL": max,
            "ROUND": round, "DC": float, "move": self._move, "choose": self._choose, "change": self._change,
            "cut": self._cut, "Jump": _Jump, **dict(_gud()), **data,
        }  # fmt: skip
        for name in ("TALC_SPHERE", "TALC_SAFE_POINT"):
            exec(_python((FOLDER / f"{name}.SPF").read_text("utf-8")), self._names)

    @property
    def edge(self) -> int:
        """The tool's edge that is in force; 0: none."""
        return int(self._system.P_TOOL)

    def safe_point(self) -> None:
        """The part program calls TALC_SAFE_POINT. Raises Collision."""
        self._names["TALC_SAFE_POINT"]()

    def _move(self, word: str, **to: float) -> None:
        to.pop("F", None)
        if "Z" in to and self.edge:
            to["Z"] += _LENGTH_MM
        met = self.machine.move(to, touching=word == "touch")
        if word == "touch":
            self._system.AC_MEA[1] = met
            self._system.AA_MM.update({axis: self.machine.at[axis] for axis in "XYZ"})

    def _choose(self, tool: float) -> None:
        self._chosen = round(tool)

    def _change(self) -> None:
        self.machine.tool = self._system.P_TOOLNO = self._chosen if self._chosen not in self.lost else 0
        self._cut(1)

    def _cut(self, edge: int) -> None:
        self._system.P_TOOL = edge


def _gud() -> Iterator[tuple[str, Any]]:
    for line in (FOLDER / "TALC_GUD.DEF").read_text("utf-8").splitlines():
        if found := re.match(r"DEF CHAN \w+ (TALC_\w+)(?:\[(\d+)\])?(?: = (SET\(.+?\)|[-\d.]+))?", line):
            name, count, value = found.groups()
            numbers = [float(v) for v in re.findall(r"-?\d+\.?\d*", value or "")]
            yield name, (numbers or [0.0] * int(count)) if count else (numbers or [0.0])[0]


def _python(program: str) -> str:
    """A function of the program's name. Raises ValueError for a block that is not known."""
    lines, depth, label = [], 0, re.search(r"^([A-Z_]+):", program, re.MULTILINE)
    for line in program.splitlines():
        block = line.split(";")[0].strip()
        if found := re.fullmatch(r"PROC (\w+)(?:\(INT (\w+)\))? .+", block):
            lines.append(f"def {found[1]}({found[2] or ''}):")
            assigned = sorted(set(re.findall(r"^\s*(TALC_\w+) = ", program, re.MULTILINE)))
            lines += [f"    global {', '.join(assigned)}"] if assigned else []
            lines += ["    try:"] if label else []
            depth = 2 if label else 1
        elif label and block == f"{label[1]}:":
            lines.append("    except Jump: pass")
            depth = 1
        elif block in ("ENDIF", "ENDFOR"):
            depth -= 1
        elif block:
            text = _statement(block)
            lines.append("    " * depth + text)
            depth += text.endswith(":")
    return "\n".join(lines)


_BLOCKS: tuple[tuple[str, Callable[..., str]], ...] = (
    (r"STOPRE|DEF REAL .+|G90 .+|M5 .+", lambda: "pass"),
    (r"D=?(0|EDGE)", lambda edge: f"cut({edge})"),
    (r"DEF INT (\w+)(?: = (\d+))?", lambda name, value: f"{name} = {value or 0}"),
    (r"RET", lambda: "return"),
    (r"M6", lambda: "change()"),
    (r"T=(\w+)", lambda tool: f"choose({tool})"),
    (r"GOTOF \w+", lambda: "raise Jump"),
    (r"IF (.+)", lambda condition: f"if {_expression(condition)}:"),
    (r"FOR (\w+) = (\d+) TO (\d+)", lambda name, first, last: f"for {name} in range({first}, {int(last) + 1}):"),
    (r"(MEAS=1 )?SUPA G[01] (.+)", lambda touch, words: f"move({'touch' if touch else 'go'!r}, {_axes(words)})"),
    (r"(\w+\(\w+\))", lambda call: call),
    (r"(R\d+|R\[.+?\]|[A-Z_]\w*) = (.+)", lambda name, value: f"{_expression(name)} = {_expression(value)}"),
)


def _statement(block: str) -> str:
    for pattern, text in _BLOCKS:
        if found := re.fullmatch(pattern, block):
            return text(*found.groups())
    raise ValueError(f"not known here: {block}")


def _axes(words: str) -> str:
    return ", ".join(f"{axis}={_expression(value)}" for axis, value in _AXIS_WORD.findall(words))


def _expression(text: str) -> str:
    for pattern, instead in _EXPRESSION:
        text = re.sub(pattern, instead, text)
    return text
