"""Whatever the bytes of a device's answers are, its driver returns complete readings or raises a driver's error."""

from collections.abc import AsyncIterator
from contextlib import AsyncExitStack

import pytest

from tests.benches.rigs import RIGS, Rig
from tests.benches.spoilt_answers import read_spoilt

pytestmark = pytest.mark.simulated_time


@pytest.fixture(params=RIGS)
async def rig(request: pytest.FixtureRequest) -> AsyncIterator[Rig]:
    async with AsyncExitStack() as stack:
        yield await RIGS[request.param](stack)


async def test_damaged_answers_give_whole_readings_or_a_driver_error(rig: Rig) -> None:
    assert await read_spoilt(rig, range(8)) >= 40, "or nothing was tried"
