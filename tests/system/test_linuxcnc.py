"""The gateway's NC side with the real LinuxCNC, as `demo --nc linuxcnc` shows it.

Its probe touches a sphere that the emulated machine moves. Needs Debian's linuxcnc-uspace. Times are LinuxCNC's, which
keeps real time. Tolerance: 0.5 s.
"""

from pathlib import Path

import numpy as np
import pytest

from gateway.cli.emulated.demo_linuxcnc import SILENCE_S, SLEW_UM_PER_S, show, silence

pytestmark = [pytest.mark.peer, pytest.mark.slow, pytest.mark.realtime]


async def test_nine_errors_come_back_and_compensation_takes_the_deviation_away(tmp_path: Path) -> None:
    said: list[str] = []
    shown = await show(tmp_path / "demo", said.append)
    # There is something to find: EZ0A, EX0C, EZ0T, ER0T, EA0C.
    assert np.abs(shown.true[[1, 2, 4, 5, 6]]).min() > 5.0
    difference = shown.measured.errors - shown.true
    assert np.abs(difference[:6]).max() <= 1.0  # µm
    assert np.abs(difference[6:]).max() <= 2.0  # µm/m
    assert np.abs(shown.before_um).max() > 20.0
    assert np.abs(shown.after_um).max() <= 1.0

    held, zero = silence(shown.silent_um)
    largest = np.abs(shown.silent_um[0, 1:]).max()
    assert largest > 20.0
    assert held == pytest.approx(SILENCE_S, abs=0.5)
    assert zero == pytest.approx(SILENCE_S + largest / SLEW_UM_PER_S, abs=0.5)
    # No fault on the way, apart from pauses of a LinuxCNC that shares its computer with the other tests.
    faults = [line for line in said if line.startswith("NC")]
    assert [line for line in faults if "stands still" not in line and line != "NC: connected again"] == []
