"""The rigs on which all devices are tested alike."""

from collections.abc import AsyncIterator
from contextlib import AsyncExitStack

import pytest

from tests.benches.rigs import RIGS, Rig


@pytest.fixture(params=RIGS)
async def rig(request: pytest.FixtureRequest) -> AsyncIterator[Rig]:
    async with AsyncExitStack() as stack:
        yield await RIGS[request.param](stack)
