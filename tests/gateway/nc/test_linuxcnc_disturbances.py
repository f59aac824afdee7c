"""One disturbance of each kind between a gateway, a real LinuxCNC and its operator. Needs Debian's linuxcnc-uspace."""

import numpy as np
import pytest

from tests.benches.linuxcnc_disturbances import OPERATOR, disturbed_linuxcnc
from tests.benches.nc_disturbances import KINDS

pytestmark = [pytest.mark.peer, pytest.mark.slow, pytest.mark.waits(35)]


@pytest.mark.parametrize(("kinds", "configuration"), [(KINDS, "mm"), (OPERATOR, "inch")])
async def test_whatever_happens_nothing_moves_farther_in_a_servo_period_than_the_control_s_slew_allows(
    kinds: tuple[str, ...], configuration: str
) -> None:
    found = await disturbed_linuxcnc(len(kinds), 5, kinds, configuration)
    assert found.excess_um <= 1e-6
    assert np.abs(found.offsets_um).max() > 0.05, "an offset of zero cannot step"
