"""Runs the probing programs of deploy/nc/sinumerik in the interpreter, and judges what the axes did.

The judge knows neither the programs nor their variables: it has the intended way as places of the axes, written here
from docs/nc.md and the programs' page, and the machine's geometry.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from simulators.nc import CycleSettings
from simulators.nc.axes import Axes, Move
from simulators.nc.channel import Channel
from simulators.nc.spindle import IN_POSITION, NO_FLUID, STANDS
from simulators.nc.synchronised import SystemVariable
from simulators.nc.tools import Tools
from tests.benches.probed_workshop import CONTACT_MM, PROBE_MM, Floats, Workshop

FOLDER = Path(__file__).parents[2] / "deploy" / "nc" / "sinumerik"
PROBING = ("SAFE_POINT", "WITHIN", "CYCLE", "OVER", "SPHERE", "TOUCH", "GO", "HERE", "SWITCH", "RESET")
NOMINAL = CycleSettings()
POSES = range(len(NOMINAL.poses_deg))
IDEAL = Workshop((NOMINAL.radius_mm, 0.0, NOMINAL.height_mm))
"""Where the programs expect the sphere."""
SAFE_Z, PROBE_TOOL = 300.0 + PROBE_MM, 99
LENGTHS = {0: 0.0, 3: 100.0, 7: 80.0, PROBE_TOOL: PROBE_MM}
REACH, CLEAR, BACK = 3.0, 30.0, 1.0
SIDES = (0, 0, 0, 0, -1, 1)
FEEDS = {"way": 3000.0, "touch": 200.0, "slow": 50.0, "dry": 500.0}
LIMITS = {"X": (-400.0, 400.0), "Y": (-400.0, 400.0), "Z": (100.0, 700.0), "A": (-120.0, 120.0), "C": (-1e9, 1e9)}
CLEARANCE_MM, BODY_CLEARANCE_MM = 2.0, 1.0
"""Nothing comes nearer than this unless it touches."""
OVERTRAVEL_MM, STOPPED_MM = 0.1, 2.5
"""How far a touch, and a move that is stopped, go on after the contact."""
DEEPER_MM = 0.02
"""How much deeper the way back may be: straight up from beside a sphere first goes along it."""
_SAME_MM = 0.2
DECLARED = {
    1: "G1",
    6: "G17",
    7: "G40",
    8: "G500",
    10: "G60",
    12: "G601",
    13: "G710",
    14: "G90",
    15: "G94",
    29: "DIAMOF",
}
"""G functions in which the probe moves."""


def program_texts() -> dict[str, str]:
    return {name: (FOLDER / f"TALC_{name}.SPF").read_text("utf-8") for name in PROBING}


@dataclass
class Cell:
    """A machine with the programs, before its part program reaches a safe point.

    texts: of the programs, by name; data: of TALC_GUD.DEF, by name
    """

    workshop: Workshop = field(
        default_factory=lambda: Workshop((NOMINAL.radius_mm + 0.4, -0.3, NOMINAL.height_mm + 0.2))
    )
    texts: Mapping[str, str] = field(default_factory=program_texts)
    data: Mapping[str, Any] = field(default_factory=dict)
    ahead: int = 1000

    def __post_init__(self) -> None:
        start = {"X": 30.0, "Y": -40.0, "Z": SAFE_Z + 100.0, "A": 10.0, "C": 0.0}
        self.axes = Axes(
            start,
            dict(LIMITS),
            self.workshop.gap,
        )
        self.tools = Tools(self.axes, LENGTHS, change_height=LIMITS["Z"][1] - 50.0)
        self.tools.begin(tool=3, edge=2, total=0, preselected=3)
        self.timers = [0.0, 1.0, 0.0]
        self.channel = Channel(
            list(self.texts.values()),
            (FOLDER / "TALC_GUD.DEF").read_text("utf-8"),
            self.axes,
            self.tools,
            variables={"AC_TIMER": SystemVariable(self.timers)},
            hooks={"TALC_SWITCH": self.axes.switch},
            ahead=self.ahead,
        )
        for index, axis in enumerate("XYZ"):
            taught = [float(IDEAL.taught(*pose)[index]) for pose in NOMINAL.poses_deg]
            self.channel.data(f"TALC_{axis}")[:] = taught
        self.channel.data("TALC_SAFE_Z")[0] = SAFE_Z
        self.channel.told.fluid_group = 5
        for name, value in self.data.items():
            self.channel.data(name)[0] = value
        self.channel.feed = 1234.0
        self.halts: list[str] = []
        """What the message said at each M0, which NC start answers; empty if spindle or fluid were on."""
        self.channel.halted = self._halted
        self.r[60], self.r[62] = 7.0, 900.0

    def _halted(self) -> None:
        safe = self.axes.spindle != "turns" and self.channel.spindle.fluid == NO_FLUID
        self.halts.append(self.message if safe else "")

    @property
    def r(self) -> list[float]:
        return self.channel.r

    @property
    def moves(self) -> list[Move]:
        return self.axes.moves

    @property
    def message(self) -> str:
        """What the control shows."""
        return self.channel.messages[-1] if self.channel.messages else ""

    def safe_point(self) -> None:
        """The part program calls TALC_SAFE_POINT. Raises ProgramAlarm and Reset."""
        self.channel.start("TALC_SAFE_POINT")

    def state(self) -> dict[str, Any]:
        """What the part program goes on with."""
        c, t = self.channel, self.tools
        loaded = (self.axes.tool, t.number, t.edge, t.sum, t.programmed_now)
        spindle = c.spindle
        on = spindle.switched != STANDS and spindle.speed != 0.0
        turns = None if spindle.mode == IN_POSITION else (spindle.direction, spindle.switched, on)
        return {
            "modal": dict(c.modal.codes),
            "F": c.feed,
            "frame": (c.frames.shift, c.frames.turned),
            "tools": loaded,
            "spindle": (spindle.mode, turns, turns or spindle.angle_deg, spindle.kind, spindle.s),
            "fluid": spindle.fluid,
            "message": self.message,
        }


@dataclass(frozen=True)
class Place:
    """Where a move is to end. kind: "way", "turn", "touch", "slow" or "back"."""

    kind: str
    end: Floats


class Intended:
    """The way of a whole cycle, from where the axes are once the probe is in the spindle.

    raised: a dry run's height, mm
    """

    def __init__(self, cell: Cell, start: Floats, raised: float = 0.0) -> None:
        self._workshop, self._raised = cell.workshop, raised
        self._at = start.copy()
        self._found = np.zeros(3)

    def places(self) -> Iterator[Place]:
        yield from self._over(0)
        for pose in POSES:
            yield from self._over(pose)
            yield from self._sphere(pose)
        yield from self._over(0)

    def _go(self, to: Mapping[str, float], kind: str = "way") -> Iterator[Place]:
        end = self._at.copy()
        for axis, value in to.items():
            index = "XYZAC".index(axis)
            end[index] = value if axis != "C" else end[4] + np.remainder(value - end[4] + 180.0, 360.0) - 180.0
        if np.any(np.abs(end - self._at) > 1e-3):
            self._at = end
            yield Place(kind, end)

    def _over(self, pose: int) -> Iterator[Place]:
        a, c = NOMINAL.poses_deg[pose]
        x, y, _ = IDEAL.taught(a, c)
        safe = SAFE_Z + self._raised
        yield from self._go({"Z": max(safe, float(self._at[2]))})
        yield from self._go({"A": a, "C": c}, "turn")
        yield from self._go({"X": float(x), "Y": float(y)})
        yield from self._go({"Z": safe})

    def _sphere(self, pose: int) -> Iterator[Place]:
        expected = IDEAL.taught(*NOMINAL.poses_deg[pose])
        true = self._workshop.taught(*NOMINAL.poses_deg[pose])
        dry = self._raised > 0
        for number in range(1 if dry else 3):
            times = 1 if number == 0 else 2
            for axis, sides in ((0, (1, -1)), (1, (1, -1) if not SIDES[pose] else (SIDES[pose],)), (2, (1,))):
                for side in sides:
                    yield from self._touches(expected, true, axis, side, times)
                if not dry:
                    expected[axis] = true[axis]

    def _touches(self, expected: Floats, true: Floats, axis: int, side: int, times: int) -> Iterator[Place]:
        def at(out: float, *, high: bool = False) -> dict[str, float]:
            to = expected + np.array([0.0, 0.0, self._raised])
            to[axis] += side * out
            if high:
                to[2] = expected[2] + self._raised + CONTACT_MM + CLEAR
            return dict(zip("XYZ", map(float, to), strict=True))

        across = np.delete(true - expected, axis)
        contact = side * (true[axis] - expected[axis]) + float(np.sqrt(CONTACT_MM**2 - across @ across))
        yield from self._go(at(CONTACT_MM + REACH, high=True))
        yield from self._go(at(CONTACT_MM + REACH))
        for time in range(times):
            kind = "slow" if time else "touch"
            if self._raised:
                yield from self._go(at(CONTACT_MM - REACH), kind)
            else:
                yield from self._go(at(contact), kind)
            last = time == times - 1
            yield from self._go(at(CONTACT_MM + REACH if last else contact + BACK), "back")
        yield from self._go(at(CONTACT_MM + REACH, high=True))


def off_the_way(cell: Cell, start: Floats, raised: float = 0.0) -> list[str]:
    """What a whole cycle did otherwise than intended; empty: nothing."""
    places = list(Intended(cell, start, raised).places())
    wrong = [] if len(places) == len(cell.moves) else [f"{len(cell.moves)} moves, intended {len(places)}"]
    for number, (move, place) in enumerate(zip(cell.moves, places, strict=False)):
        off = float(np.max(np.abs(move.path[-1] - place.end)))
        if off > _SAME_MM:
            return [*wrong, f"move {number} ends {off:.2f} off the intended {place.kind} to {place.end}"]
        wrong += [f"move {number}: {fault}" for fault in _unlike(move, place, raised)]
    return wrong


def _unlike(move: Move, place: Place, raised: float) -> Iterator[str]:
    touches = place.kind in ("touch", "slow")
    feed = FEEDS[place.kind] if touches else FEEDS["dry" if raised else "way"] / (2.0 if place.kind == "turn" else 1.0)
    if abs(move.feed - feed) > 1e-6:
        yield f"{place.kind} at {move.feed:g}, intended {feed:g}"
    if move.measures != (place.kind != "back"):
        yield f"{place.kind} {'with' if move.measures else 'without'} MEAS"
    if move.met != (touches and not raised):
        yield f"{place.kind} {'met something' if move.met else 'met nothing'}"


def unsafe(cell: Cell, raised: float = 0.0) -> list[str]:
    """What no cycle may do, whatever happens in it; empty: nothing."""
    if not cell.moves:
        return []
    paths = np.vstack([move.path for move in cell.moves])
    ends = np.cumsum([len(move.path) for move in cell.moves])[:-1]
    ball, body = (np.split(gap, ends) for gap in (cell.workshop.gap(paths), cell.workshop.body_gap(paths)))
    wrong = list[str]()
    before: Move | None = None
    knows_fluid = bool(cell.channel.data("TALC_FLUID_GROUP")[0])
    for number, move in enumerate(cell.moves):
        faults = [*_too_near(move, before, ball[number], body[number]), *_too_low(move, before, SAFE_Z + raised)]
        faults += ["the cutting fluid is on"] * (move.fluid != NO_FLUID and knows_fluid)
        wrong += [f"move {number}: {fault}" for fault in [*faults, *_unready(move)]]
        before = move
    return wrong


def _touches(move: Move) -> bool:
    return move.measures and move.feed <= FEEDS["touch"]


def _too_near(move: Move, before: Move | None, ball: Floats, body: Floats) -> Iterator[str]:
    nearest = float(np.min(ball))
    if np.min(body) < BODY_CLEARANCE_MM:
        yield f"stylus or probe are {np.min(body):.2f} mm from something"
    if before is not None and before.met:
        if nearest < ball[0] - DEEPER_MM:
            yield "does not leave what was touched"
    elif move.met:
        deepest = OVERTRAVEL_MM if _touches(move) else STOPPED_MM
        if nearest < -deepest:
            yield f"is stopped {-nearest:.2f} mm within what it touches"
    elif nearest < (0.0 if _touches(move) else CLEARANCE_MM) and np.any(np.diff(ball) < -1e-9):
        # a move that only leaves began where another, which is judged too, or a hand had ended
        yield f"the ball is {nearest:.2f} mm from something"


def _too_low(move: Move, before: Move | None, safe: float) -> Iterator[str]:
    """Below TALC_SAFE_Z only up, or at the sphere of the pose at which the table is, and there with MEAS."""
    low = move.path[:, 2] < safe - 1e-6
    if not np.any(low):
        return
    up = not np.ptp(move.path[:, :2], axis=0).any() and bool(np.all(np.diff(move.path[:, 2]) >= 0.0))
    leaves = before is not None and before.met
    if np.ptp(move.path[:, 3:], axis=0).any():
        yield "the table turns below TALC_SAFE_Z"
    if not (up or leaves or move.measures or (before is not None and _touches(before))):
        yield "moves beside the sphere without MEAS"
    if not up:
        a, c = move.path[-1, 3:]
        here = [IDEAL.taught(*pose)[:2] for pose in NOMINAL.poses_deg if _is_at(pose, float(a), float(c))]
        if not here or np.max(np.abs(move.path[low, :2] - here[0])) > CONTACT_MM + REACH + 1.0:
            yield "moves below TALC_SAFE_Z elsewhere than at the sphere"


def _is_at(pose: tuple[float, float], a: float, c: float) -> bool:
    return abs(pose[0] - a) < 1e-3 and abs((pose[1] - c + 180.0) % 360.0 - 180.0) < 1e-3


def _unready(move: Move) -> Iterator[str]:
    if _touches(move) and not move.from_rest:
        yield "a touch begins while an axis still moves"
    if move.tool != PROBE_TOOL or move.spindle != "0°":
        yield f"moves with tool {move.tool}, whose spindle is: {move.spindle}"
    if other := {code for group, code in DECLARED.items() if move.modal[group] != code}:
        yield f"moves without {', '.join(sorted(other))}"
    if move.feed > FEEDS["way"]:
        yield f"moves at {move.feed:g}"


def centres_off_um(cell: Cell, raised: float = 0.0) -> float:
    """Largest distance of the reported centres from where they are; in a dry run from where they are expected."""
    there = IDEAL if raised else cell.workshop
    found = np.array(cell.r[70:88]).reshape(len(POSES), 3) - [0.0, 0.0, raised]
    return 1e3 * float(np.max(np.abs(found - [there.taught(*pose) for pose in NOMINAL.poses_deg])))


def started_at(cell: Cell) -> Floats:
    """(5,) where the axes are once the probe is in the spindle."""
    height = cell.tools.change_height
    at = np.array([cell.axes.position[axis] for axis in "XYZAC"])
    if height is not None:
        at[2] = height
    return at


def reported(cell: Cell) -> Sequence[tuple[int, float]]:
    """R-parameters that were written, in order, without those that only state a version."""
    return [(number, value) for number, value, _, _ in cell.channel.written if number != 89]
