"""Load cases: lengths, one axis at a time, and their effect on the plant."""

import numpy as np
import pytest

from simulators.cases import long_term, random_axes, table_and_fluid, warm_up_and_cool_down
from simulators.cases.series import DRAWN_AXES
from simulators.plant import Environment, MachineDrive, Plant, load_machine, record_drive

CALM = Environment(mean_degC=22, daily_amplitude_K=0, weather_sigma_K=0, gradient_K_m=0, door_openings_per_day=0)


def test_long_term_lasts_340_hours_in_three_halls() -> None:
    stretches = long_term(1)
    assert [len(s.drives) / 12 for s in stretches] == [196, 72, 72]
    assert len({s.environment.mean_degC for s in stretches}) == 3


def test_one_axis_at_a_time_and_every_one_in_turn() -> None:
    drives = random_axes(3, 2000)
    moving = np.array([[getattr(d, axis) > 0 for axis in DRAWN_AXES] for d in drives])
    assert moving.sum(axis=1).max() == 1
    assert moving.mean(axis=0) == pytest.approx(1 / 6, abs=0.04)
    assert np.mean([d.coolant_on for d in drives]) == pytest.approx(0.3, abs=0.04)
    assert drives == random_axes(3, 2000)
    assert drives != random_axes(4, 2000)


def test_spindle_grows_while_it_turns_and_shrinks_after() -> None:
    drives = warm_up_and_cool_down("spindle_speed")
    growth = record_drive(Plant(load_machine(), CALM, 1), drives).inputs[:, 29]
    assert growth[47] > growth[5] > 1.0
    assert growth[-1] < 0.2 * growth[47]


def test_table_and_fluid_cases_differ_in_the_fluid_and_the_nights() -> None:
    dry, wet, changing, shifts = (table_and_fluid(letter, 2).drives for letter in ("A", "B", "C", "D"))
    assert len(dry) == 120 * 12
    speed = [d.speed_c for d in dry]
    assert speed == [d.speed_c for d in wet] == [d.speed_c for d in changing]
    assert 120 <= min(s for s in speed if s) < max(speed) <= 1200
    assert 0 in speed
    assert not any(d.coolant_on for d in dry)
    assert all(d.coolant_on for d in wet)
    on = np.array([d.coolant_on for d in changing])
    runs = np.diff(np.flatnonzero(np.diff(on)))
    assert runs.min() >= 2 * 12
    assert runs.max() <= 8 * 12
    for k, (by_day, always) in enumerate(zip(shifts, changing, strict=True)):
        assert by_day == (always if k / 12 % 24 < 16 else MachineDrive())
    assert dry != table_and_fluid("A", 3).drives


def test_wrong_numbers_are_named() -> None:
    with pytest.raises(ValueError, match="letter 'E'"):
        table_and_fluid("E", 1)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="hours = 0"):
        table_and_fluid("A", 1, hours=0)
    with pytest.raises(ValueError, match=r"share = 1\.5"):
        warm_up_and_cool_down("speed_c", share=1.5)
    with pytest.raises(ValueError, match="wet_share = -1"):
        random_axes(1, 3, wet_share=-1)
    with pytest.raises(ValueError, match="steps = -1"):
        random_axes(1, -1)
