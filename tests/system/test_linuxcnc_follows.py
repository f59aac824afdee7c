"""The real LinuxCNC in motion, measured in every servo period: its component follows what the method's kinematics say.
Needs Debian's linuxcnc-uspace and linuxcnc-uspace-dev.
"""

from pathlib import Path

import pytest

from tests.benches.linuxcnc_motion import MOTIONS, by_errors, in_motion, left_um, machine

pytestmark = [pytest.mark.peer, pytest.mark.slow]


async def test_in_every_motion_nothing_is_left_at_the_tool(tmp_path: Path) -> None:
    async with machine(tmp_path) as bench:
        await by_errors(bench)
        for motion in MOTIONS:
            async with in_motion(bench, tmp_path / "machine" / "nc", motion):
                left, constant = await left_um(bench, 3.0)
            assert constant.max() > 2.0, "it moves"
            assert left.max() <= 0.002, motion
