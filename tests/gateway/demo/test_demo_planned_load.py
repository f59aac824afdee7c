"""The demo declares a load that a person may plan, and its machine does enough for the gateway to foresee it."""

import tomllib
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from gateway.demo.demo_machine import Demo, talc_section
from simulators.nc import LoadCase
from simulators.plant import Environment, MachineDrive, Plant, load_machine, record_drive
from simulators.plant.recording import LOAD_NAMES
from talc.planned import learn_response

TWO_DAYS_AND_A_BIT = 2 * 288 + 12
STEP_S = 300.0


def demo(method: Literal["learner", "models"] = "learner", preset: str | None = None) -> Demo:
    return Demo(72.0, method, preset, None, 6000.0, 1, Path("out"), 7447, (), plain=True)


def as_the_demo_cuts(seed: int) -> list[MachineDrive]:
    """What its control does in each step."""
    case = LoadCase.random(seed, TWO_DAYS_AND_A_BIT * STEP_S, start_hour=6.0)
    means = np.diff([case.integral(step * STEP_S) for step in range(TWO_DAYS_AND_A_BIT + 1)], axis=0) / STEP_S
    return [
        MachineDrive(
            speed_x=x, speed_y=y, speed_z=z, speed_a=a, speed_c=c, spindle_speed=spindle, coolant_on=coolant >= 0.5
        )
        for x, y, z, a, c, spindle, coolant in means.tolist()
    ]


def test_after_two_days_the_demos_warm_up_is_foreseen_to_heat_the_spindle() -> None:
    (planned,) = tomllib.loads("[talc]\n" + talc_section(demo()))["planned_load"]
    plant = Plant(load_machine(), Environment(), 1)
    plant.advance(12 * 3600.0, MachineDrive())
    record = record_drive(plant, as_the_demo_cuts(1))
    names, inputs, good = record.input_names, record.inputs, np.ones(record.inputs.shape, dtype=np.bool_)
    loads = [name for name in LOAD_NAMES if name != "coolant"]
    response = learn_response(names, inputs, good, loads)
    assert response is not None
    cold = inputs.copy()
    cold[-72:, [names.index(name) for name in loads]] = 0.0  # it stood still for six hours
    changes = response.changes(names, cold, good, planned["loads"], 24)
    assert changes is not None, "larger than any load of these days"
    for name, least in (("spindle_front", 0.5), ("spindle_motor", 1.0), ("spindle_growth", 4.0)):
        assert changes[-1, names.index(name)] > least, name


@pytest.mark.parametrize("preset", [None, "blaser-2019"])
def test_a_demo_without_forecasts_declares_none(preset: str | None) -> None:
    assert "planned_load" not in tomllib.loads("[talc]\n" + talc_section(demo("models", preset)))
