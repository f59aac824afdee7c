"""The agent's watch over a cycle, where LinuxCNC's status is older than its pins, as on a busy computer.

Without LinuxCNC: its status and pins are given step by step.
"""

import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from simulators.linuxcnc.machine import FILES
from tests.benches.linuxcnc_module import linuxcnc_module

MDI, IDLE, READING, CALL = 3, 1, 2, "o<talc_safe_point> call"
COORDINATED, BY_HAND = 2, 3
G59_3, G54 = 9, 1


@pytest.fixture
def cycle(monkeypatch: pytest.MonkeyPatch) -> Any:
    """A cycle whose request 7 the program has just taken; LinuxCNC's modules have only their constants."""
    numbers = {
        "STATE_ON": 4, "INTERP_IDLE": IDLE, "RCS_EXEC": 2, "MODE_MANUAL": 1, "MODE_AUTO": 2, "MODE_MDI": MDI,
        "TRAJ_MODE_COORD": COORDINATED,
    }  # fmt: skip
    linuxcnc, hal = ModuleType("linuxcnc"), ModuleType("hal")
    linuxcnc.__dict__.update(numbers)
    set_in_hal: set[str] = set()
    hal.__dict__["get_value"] = lambda name: int(name in set_in_hal)
    monkeypatch.setitem(sys.modules, "linuxcnc", linuxcnc)
    monkeypatch.setitem(sys.modules, "hal", hal)
    monkeypatch.syspath_prepend(str(FILES))
    pins = {
        "answers": 0.0,
        "state": 0.0,
        "reason": 0.0,
        "result-of": 0.0,
        "request": 0.0,
        "withdrawn": 0.0,
        "spread": 0.0,
        "called": False,
        "may-start": True,
    }
    pins |= {f"centre-{pose}-{axis}": 0.0 for pose in range(6) for axis in "xyz"}
    path = SimpleNamespace(least_dry_run_mm=lambda: 0.0, obstacle=lambda *_: "", is_low=lambda _: False)
    it = linuxcnc_module("talc_cycle").Cycle(pins, path)
    it.request(0.0, 7, 900.0, 0.0)
    pins |= {"answers": 7.0, "state": 1.0}
    return SimpleNamespace(it=it, pins=pins, path=path, set_in_hal=set_in_hal)


def status(**changed: object) -> Any:
    """LinuxCNC's, while it calls the cycle in MDI."""
    at_work = {
        "task_state": 4, "homed": [1], "joints": 1, "task_mode": MDI, "command": CALL, "interp_state": READING,
        "state": 2, "queued_mdi_commands": 0, "motion_mode": COORDINATED,
        "g5x_index": G59_3,
    }  # fmt: skip
    return SimpleNamespace(**at_work | changed)


OLD = (status(command="", interp_state=IDLE, state=1), status(command="", queued_mdi_commands=1), status(command=""))


@pytest.mark.parametrize("old", OLD)
def test_a_linuxcnc_that_stood_still_meanwhile_may_show_an_old_status_first(old: Any, cycle: Any) -> None:
    for now, seen in ((0.1, None), (3.0, None), (3.1, old), (3.3, status()), (6.0, status())):
        cycle.it.step(now, seen, None)
    assert cycle.pins["withdrawn"] == 0.0
    cycle.pins |= {"state": 3.0, "result-of": 7.0}
    cycle.it.step(6.1, status(), None)
    assert cycle.it.status(7)["state"] == "done"


@pytest.mark.parametrize("old", OLD)
def test_a_status_from_before_the_program_began_does_not_void_the_cycle(old: Any, cycle: Any) -> None:
    for now, seen in ((0.1, old), (0.3, old), (0.5, status()), (0.7, status())):
        cycle.it.step(now, seen, None)
    assert cycle.it.status(7)["state"] == "accepted"
    cycle.pins |= {"state": 3.0, "result-of": 7.0}
    cycle.it.step(0.9, status(), None)
    assert cycle.it.status(7)["state"] == "done"


@pytest.mark.parametrize(
    ("foreign", "from_s"),
    [
        ({"queued_mdi_commands": 1}, 0.1),
        ({"queued_mdi_commands": 1}, 0.5),
        ({"command": "G0 X5"}, 0.5),
        ({"motion_mode": BY_HAND}, 0.5),
    ],
)
def test_what_somebody_else_commands_voids_it_also_from_its_beginning(
    foreign: dict[str, object], from_s: float, cycle: Any
) -> None:
    for tenth in range(1, 30):
        cycle.it.step(tenth / 10, status(**foreign) if tenth / 10 >= from_s else status(), None)
    assert cycle.pins["withdrawn"] == -7.0
    cycle.pins |= {"state": 5.0, "reason": 21.0}
    cycle.it.step(3.1, status(), None)
    assert (cycle.it.status(7)["state"], cycle.it.status(7)["code"]) == ("failed", "foreign")


@pytest.mark.parametrize("pin", ["motion.switchkins-type", "motion.eoffset-active"])
def test_other_kinematics_and_an_offset_that_come_and_go_within_one_move_void_it(pin: str, cycle: Any) -> None:
    """The program itself looks between its moves only."""
    for tenth in range(1, 10):
        cycle.set_in_hal.clear()
        if tenth == 5:
            cycle.set_in_hal.add(pin)
        cycle.it.step(tenth / 10, status(), None)
    assert cycle.pins["withdrawn"] == -7.0
    cycle.pins |= {"state": 3.0, "result-of": 7.0}
    cycle.it.step(1.0, status(), None)
    assert (cycle.it.status(7)["state"], cycle.it.status(7)["code"]) == ("failed", "foreign")


class Commands:
    """What the agent commands."""

    def __init__(self) -> None:
        self.given: list[str] = []

    def mode(self, _: int) -> None:
        pass

    def mdi(self, block: str) -> None:
        self.given.append(block)

    def abort(self) -> None:
        self.given.append("abort")


RECOVER = "o<talc_recover> call"
AT_REST = {"command": "", "interp_state": IDLE, "state": 1, "joint": [], "spindle": [], "spindles": 0}


@pytest.mark.parametrize(
    ("by_agent", "changed", "code", "given"),
    [
        (True, {}, "interpreter", [RECOVER, "abort"]),
        (True, {"g5x_index": G54}, "stopped", ["abort"]),
        (False, {}, "interpreter", ["abort"]),
        (None, {}, "may_start_ended", ["abort", "abort"]),
        (True, {"task_mode": 2}, "other_mode", ["abort", "abort"]),
        (True, {"homed": [0]}, "not_ready", ["abort"]),
    ],
    ids=[
        "an error of the interpreter",
        "somebody's stop",
        "a part program's",
        "not allowed any more",
        "in another mode",
        "not homed",
    ],
)
def test_only_an_error_of_the_interpreter_lets_the_agent_take_its_own_cycle_up(
    by_agent: bool | None, changed: dict[str, object], code: str, given: list[str], cycle: Any
) -> None:
    """by_agent: None when the door is opened meanwhile."""
    commands, stopped = Commands(), status(**AT_REST | changed)
    if by_agent is not False:
        cycle.pins |= {"answers": 0.0, "state": 0.0}
        for now in (0.01, 0.02):
            cycle.it.step(now, status(**AT_REST), commands)
        assert commands.given == [CALL]
        cycle.pins |= {"answers": 7.0, "state": 1.0}
    commands.given.clear()
    cycle.it.step(0.1, status(), commands)
    cycle.pins["may-start"] = by_agent is not None
    for now in (0.2, 1.0):
        cycle.it.step(now, stopped, commands)
    assert cycle.it.status(7)["state"] == ("accepted" if RECOVER in given else "failed")
    for now in (1.1, 1.9):
        cycle.it.step(now, stopped, commands)
    assert (cycle.it.status(7)["state"], cycle.it.status(7)["code"]) == ("failed", code)
    assert commands.given == given


@pytest.mark.parametrize("changed", [{"g5x_index": G54}, {"task_mode": 2}, {"homed": [0]}, None])
def test_after_a_stop_the_agent_begins_no_cycle_until_somebody_allows_it_again(
    changed: dict[str, object] | None, cycle: Any
) -> None:
    """Also where the probe was at the safe height: the table turns there. None: the program has not even started."""
    commands = Commands()
    if changed is None:
        cycle.pins |= {"answers": 0.0, "state": 0.0}
    cycle.it.step(0.1, status(**AT_REST) if changed is None else status(), commands)
    for now in (0.2, 1.0, 1.9, 11.9):
        cycle.it.step(now, status(**AT_REST | (changed or {})), commands)
    assert cycle.it.status(7)["state"] == ("refused" if changed is None else "failed")
    commands.given.clear()
    cycle.pins |= {"answers": 0.0, "state": 0.0}
    cycle.it.request(12.0, 8, 900.0, 0.0)
    for now in (12.1, 12.2):
        cycle.it.step(now, status(**AT_REST), commands)
    assert cycle.it.obstacle(status(**AT_REST)).code == "halted"
    assert commands.given == []
    for allowed in (False, True):
        cycle.pins["may-start"] = allowed
        for now in (12.3, 12.4):
            cycle.it.step(now, status(**AT_REST), commands)
    assert commands.given == [CALL]


def test_the_agent_begins_no_cycle_while_the_probe_is_low(cycle: Any) -> None:
    commands, low = Commands(), True
    cycle.path.is_low = lambda _: low
    cycle.pins |= {"answers": 0.0, "state": 0.0}
    for now in (0.1, 0.2):
        cycle.it.step(now, status(**AT_REST), commands)
    assert cycle.it.obstacle(status(**AT_REST)).code == "probe_is_low"
    assert commands.given == []
    low = False
    for now in (0.3, 0.4):
        cycle.it.step(now, status(**AT_REST), commands)
    assert commands.given == [CALL]
