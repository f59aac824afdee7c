"""How long the real-time component takes in a servo period of the real LinuxCNC. Needs Debian's linuxcnc-uspace-dev."""

import numpy as np
import pytest

from tests.benches.linuxcnc_period import periods_us

pytestmark = [pytest.mark.peer, pytest.mark.slow, pytest.mark.realtime]


async def test_most_periods_of_the_component_are_far_shorter_than_5_us() -> None:
    took_us = await periods_us(3.0)
    assert took_us.size == 3000
    # Half of them: other programs of a busy computer count in the rest, as there is no real-time kernel.
    assert 0.05 < np.median(took_us) < 5.0
