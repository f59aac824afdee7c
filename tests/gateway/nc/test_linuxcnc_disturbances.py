"""One disturbance of each kind between a gateway and the real LinuxCNC. Needs Debian's linuxcnc-uspace."""

import numpy as np
import pytest

from tests.benches.linuxcnc_disturbances import disturbed_linuxcnc
from tests.benches.nc_disturbances import KINDS

pytestmark = [pytest.mark.peer, pytest.mark.slow]


async def test_whatever_happens_nothing_moves_farther_in_a_servo_period_than_the_control_s_slew_allows() -> None:
    found = await disturbed_linuxcnc(len(KINDS), seed=5)
    assert found.excess_um <= 1e-6
    assert np.abs(found.offsets_um).max() > 0.05, "an offset of zero cannot step"
