"""How long the real-time component takes in a servo period of the real LinuxCNC. Needs Debian's linuxcnc-uspace-dev."""

import numpy as np
import pytest

from tests.benches.linuxcnc_core import core_us
from tests.benches.linuxcnc_period import periods_us

pytestmark = [pytest.mark.peer, pytest.mark.slow, pytest.mark.realtime]


async def test_most_periods_of_the_component_are_far_shorter_than_5_us() -> None:
    took_us = await periods_us(3.0)
    assert took_us.shape == (3000, 2)
    # Half of them: other programs of a busy computer count in the rest, as there is no real-time kernel.
    assert 0.05 < np.median(took_us[:, 0]) < 5.0
    assert np.median(took_us[:, 1]) > 0.05, "LinuxCNC's own function, for comparison"


def test_the_core_by_itself_is_far_shorter_in_every_situation() -> None:
    """The least of several times of each."""
    took_us = core_us(2000)
    assert took_us.shape == (2000,)
    assert 0.0 < took_us.min() < took_us.max() < 5.0
