"""Presets against the figures printed in the papers."""

from dataclasses import replace
from typing import Any

import pytest

from talc.presets import PRESETS, completed, preset
from talc.settings import ControlSettings, LearnerSettings, TalcSettings, TrainingSettings


def test_zimmermann_2022_is_what_its_table_2_says() -> None:
    z22 = PRESETS["zimmermann-2022"]
    assert z22.control.calibration_steps * 5 == 24 * 60
    assert (z22.control.no_good_measurements, z22.control.no_good_interval_steps * 5) == (16, 5)
    assert z22.control.policy == "novelty"  # "adaptive"
    assert (z22.control.acl, z22.training.selector, z22.training.static_inputs) == ("training", "pso", False)
    assert (z22.training.max_na, z22.training.max_nb, z22.training.safety) == (5, 5, 0.75)


def test_blaser_2019_is_its_best_common_set() -> None:
    b19 = PRESETS["blaser-2019"]
    assert b19.control.calibration_steps * 5 == 6.5 * 60
    assert b19.control.measurement_interval_steps * 5 == 120
    assert (b19.control.no_good_measurements, b19.control.no_good_interval_steps * 5) == (12, 10)
    assert (b19.control.acl, b19.control.acl_fixed_um, b19.control.acl_fixed_um_per_m) == ("fixed", 5.0, 15.0)


def test_a_key_beside_a_preset_wins_and_the_others_stay() -> None:
    table = completed({"preset": "blaser-2019", "control": {"calibration_steps": 144}})
    control, before = table["control"], PRESETS["blaser-2019"].control
    assert isinstance(control, dict)
    assert control["calibration_steps"] == 144
    assert control["no_good_measurements"] == before.no_good_measurements
    assert completed(table) == table


def test_fits_are_guarded_unless_they_are_to_be_as_printed() -> None:
    for name, settings in PRESETS.items():
        assert settings.training.estimator == "guarded"
        table: dict[str, Any] = completed({"preset": name, "exact": True})
        sections = {"control": ControlSettings, "learner": LearnerSettings, "training": TrainingSettings}
        printed = TalcSettings(**table | {part: kind(**table[part]) for part, kind in sections.items()})
        assert printed == preset(name, exact=True)
        assert printed == replace(settings, exact=True, training=replace(settings.training, estimator="least_squares"))
    with pytest.raises(ValueError, match="exact = True: expected false without a preset"):
        TalcSettings(exact=True)


def test_without_a_known_preset_nothing_is_added() -> None:
    for table in ({"method": "learner"}, {"preset": "zimmerman-2022"}, {"preset": 3}):
        assert completed(table) == table


def test_every_preset_carries_its_name() -> None:
    assert all(settings.preset == name for name, settings in PRESETS.items())
