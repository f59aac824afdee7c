"""Whatever the bytes of a device's answers are, its driver returns complete readings or raises a driver's error."""

import pytest

from tests.benches.rigs import Rig
from tests.benches.spoilt_answers import read_spoilt

pytestmark = pytest.mark.simulated_time


async def test_damaged_answers_give_whole_readings_or_a_driver_error(rig: Rig) -> None:
    assert await read_spoilt(rig, range(4)) >= 20, "or nothing was tried"
