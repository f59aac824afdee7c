"""The sphere under LinuxCNC's probe moves like the plant's. LinuxCNC's Python lacks what the plant needs."""

import math

import pytest

from simulators.linuxcnc.chain import centre_mm
from simulators.plant import RADIUS_MM, Environment, MachineDrive, Plant, load_machine

HEIGHT_MM = 80.0
POSES = ((0, 0), (0, 90), (0, 180), (0, 270), (90, 0), (-90, 0), (-37, 481))


def test_sphere_is_off_by_what_the_plant_deviates() -> None:
    plant = Plant(load_machine(), Environment(), 1)
    plant.advance(2 * 3600.0, MachineDrive(speed_x=6000.0, speed_c=1200.0, spindle_speed=12000.0, coolant_on=True))
    for a_deg, c_deg in POSES:
        a, c = math.radians(a_deg), math.radians(c_deg)
        y = RADIUS_MM * math.sin(c)
        ideal = (
            RADIUS_MM * math.cos(c),
            y * math.cos(a) - HEIGHT_MM * math.sin(a),
            y * math.sin(a) + HEIGHT_MM * math.cos(a),
        )
        off = plant.deviation_um(*ideal, a_deg, c_deg)
        assert max(abs(off)) > 5.0
        found = centre_mm(plant.errors().tolist(), a_deg, c_deg, RADIUS_MM, HEIGHT_MM)
        assert found == pytest.approx([i + o * 1e-3 for i, o in zip(ideal, off, strict=True)], abs=1e-6)
