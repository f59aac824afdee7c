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
OTHERS = "somebody else moved the machine or changed its modes"


@pytest.fixture
def cycle(monkeypatch: pytest.MonkeyPatch) -> Any:
    """A cycle whose request 7 the program has just taken; LinuxCNC's modules have only their constants."""
    numbers = {
        "STATE_ON": 4, "INTERP_IDLE": IDLE, "RCS_EXEC": 2, "MODE_MANUAL": 1, "MODE_AUTO": 2, "MODE_MDI": MDI,
        "TRAJ_MODE_COORD": COORDINATED,
    }  # fmt: skip
    linuxcnc, hal = ModuleType("linuxcnc"), ModuleType("hal")
    linuxcnc.__dict__.update(numbers)
    hal.__dict__["get_value"] = lambda _: 0
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
    }
    pins |= {f"centre-{pose}-{axis}": 0.0 for pose in range(6) for axis in "xyz"}
    path = SimpleNamespace(least_dry_run_mm=lambda: 0.0, obstacle=lambda *_: "")
    it = linuxcnc_module("talc_cycle").Cycle(pins, path)
    it.request(0.0, 7, 900.0, 0.0)
    pins |= {"answers": 7.0, "state": 1.0}
    return SimpleNamespace(it=it, pins=pins)


def status(**changed: object) -> Any:
    """LinuxCNC's, while it calls the cycle in MDI."""
    at_work = {
        "task_state": 4, "homed": [1], "joints": 1, "task_mode": MDI, "command": CALL, "interp_state": READING,
        "state": 2, "queued_mdi_commands": 0, "motion_mode": COORDINATED,
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
    assert (cycle.it.status(7)["state"], cycle.it.status(7)["reason"]) == ("failed", OTHERS)
