"""Tool, edge and preselection of a channel, as machine data has the control keep them.

MD22550 (T prepares, or changes at once), MD20270 (edge after a change), MD20310 bit 0 (magazine management): Siemens'
list of machine data, and its list of system variables 05/2017 for what `$P_TOOLNO` and GETEXET say.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from simulators.nc.axes import Axes
from simulators.nc.synchronised import ProgramAlarm


@dataclass(slots=True)
class Tools:
    """axes: whose spindle holds the tool; lengths: of each tool, mm."""

    axes: Axes
    lengths: Mapping[int, float]
    mode: int = 1
    """MD22550: 1 T prepares and M6 changes, 0 T changes at once."""
    default: int = 1
    """MD20270: edge after a change; -1 the same number, -2 the old tool's stays in force, 0 none."""
    managed: bool = False
    """Magazine management."""
    sum_default: int = 0
    """MD20272: DL after a new edge."""
    change_height: float | None = None
    """Where Z goes to change the tool; None: it stays."""
    lost: frozenset[int] = frozenset()
    """Tools whose place in the magazine is empty."""
    edge: int = 0
    """$P_TOOL: D in force."""
    sum: int = 0
    """DL in force."""
    programmed_now: int = 0
    _active: int = 0
    _loaded: int | None = None
    changes: list[int] = field(default_factory=list)

    @property
    def loaded(self) -> int:
        """What the interpretation takes to be in the spindle."""
        return self.axes.tool if self._loaded is None else self._loaded

    def begin(self, tool: int, edge: int, total: int, preselected: int) -> None:
        """State in which a program starts."""
        self.axes.tool = self._active = tool
        self._loaded = tool
        self.edge, self.sum, self.programmed_now = edge, total, preselected

    def keep_offset_of(self, tool: int) -> None:
        """The old tool's offset is still in force: MD20270 is -2, and no D has been programmed since the change."""
        self._active = tool

    @property
    def number(self) -> int:
        """$P_TOOLNO: tool of the active D. With MD20270 0 it says nothing of a tool without D, with -2 the old one."""
        return 0 if self.default == 0 and not self.edge else self._active

    @property
    def programmed(self) -> int:
        if self.managed:
            raise ProgramAlarm("$P_TOOLP cannot be used with magazine management: GETSELT")
        return self.programmed_now

    def asked(self, procedure: str) -> int:
        """GETEXET: tool in the spindle; GETSELT: preselected one. Raises ProgramAlarm without magazine management."""
        if not self.managed:
            raise ProgramAlarm(f"{procedure}: no magazine management")
        return self.axes.tool if procedure == "GETEXET" else self.programmed_now

    @property
    def length_mm(self) -> float:
        """Of the tool whose edge is in force."""
        return self.lengths.get(self._active, 0.0) if self.edge else 0.0

    def select(self, tool: int) -> Callable[[], None]:
        """T: preparation, or the change itself; what the main run does. Raises ProgramAlarm for one not known."""
        if tool and tool not in self.lengths:
            raise ProgramAlarm(f"T{tool}: not known")
        self.programmed_now = tool
        return self._changed(tool) if self.mode == 0 else _nothing

    def change(self) -> Callable[[], None]:
        """M6."""
        return self._changed(self.programmed_now) if self.mode == 1 else _nothing

    def cut(self, edge: int) -> None:
        """D: the edge of the tool that is loaded."""
        self.edge, self._active = edge, self.loaded
        self.sum = self.sum_default if edge else 0

    def _changed(self, tool: int) -> Callable[[], None]:
        same = tool == self.loaded
        self._loaded = tool
        if not same and self.default != -2:
            self._active = tool
            self.edge = self.edge if self.default == -1 else self.default
            self.sum = self.sum_default if self.edge else 0

        def change() -> None:
            if self.change_height is not None:
                self.axes.position["Z"] = self.change_height
            self.axes.tool = 0 if tool in self.lost else tool
            self._loaded = self.axes.tool
            if self._active == tool:
                self._active = self.axes.tool
            self.changes.append(self.axes.tool)

        return change


def _nothing() -> None: ...
