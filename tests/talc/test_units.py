"""Units that the names of columns end with."""

import math

import pytest

from talc.names import MICROMETRE, MICROMETRE_PER_METRE
from talc.units import COLUMN_UNITS, named_unit


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("EZ0T_mm", "mm"),
        ("lift [mm]", "mm"),
        ("drift_nm", "nm"),
        ("lift (M)", "m"),
        ("tilt [µrad] ", "urad"),
        ("tilt_μrad", "urad"),
        ('EA0C ["]', "arcsec"),
        ('EA0C "', "arcsec"),
        ("slope [um/m]", "um/m"),
        ("EX0C in", ""),
        ("EX0C_m", ""),
        ("EX0C [in]", "in"),
        ("EX0C [kg]", ""),
        ("column", ""),
    ],
)
def test_the_unit_at_the_end_of_a_name_is_found_and_others_are_not_guessed(name: str, unit: str) -> None:
    assert named_unit(name) == unit


def test_lengths_are_in_micrometres_and_angles_in_micrometres_per_metre() -> None:
    assert COLUMN_UNITS["in"] == (MICROMETRE, 25_400.0)
    assert COLUMN_UNITS["nm"] == (MICROMETRE, 0.001)
    assert {COLUMN_UNITS[unit][0] for unit in ("um", "mm", "m")} == {MICROMETRE}
    unit, factor = COLUMN_UNITS["arcsec"]
    assert unit == MICROMETRE_PER_METRE
    assert factor * 3600 * 180 == pytest.approx(math.pi * 1e6)
    assert COLUMN_UNITS["deg"][1] == pytest.approx(3600 * factor)
