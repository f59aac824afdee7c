"""The gateway's NC side with the real LinuxCNC, as `demo --nc linuxcnc` shows it.

Its probe touches a sphere that the emulated machine moves. Needs Debian's linuxcnc-uspace. Times are those of
LinuxCNC's own clock.
"""

from pathlib import Path

import numpy as np
import pytest

from gateway.demo.demo_linuxcnc import SILENCE_S, SLEW_UM_PER_S, show, silence
from gateway.model.codes import NoticeCode
from gateway.model.notice import Notice
from gateway.model.text import Language

pytestmark = [pytest.mark.peer, pytest.mark.slow, pytest.mark.waits(140)]

LATE_S, SHORT_S = 3.0, 0.1
PAUSES = {
    *(NoticeCode.NC_NOT_CONNECTED, NoticeCode.NC_CONNECTED_AGAIN, NoticeCode.NC_SLOW, NoticeCode.NC_IN_TIME),
    *(NoticeCode.NC_WATCHDOG_UNHEARD, NoticeCode.NC_WATCHDOG_SILENT, NoticeCode.NC_WATCHDOG_HEARD),
}
"""Of this computer, which LinuxCNC and the gateway share with other tests."""


async def test_nine_errors_come_back_and_compensation_takes_the_deviation_away(tmp_path: Path) -> None:
    said: list[str] = []
    notices: list[Notice] = []
    shown = await show(tmp_path / "demo", said.append, Language(), notices.append)
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
    # A busy computer may look late: after the last heartbeat for the first time, and again after the end.
    assert SILENCE_S - LATE_S < held < SILENCE_S + SHORT_S
    assert zero == pytest.approx(SILENCE_S + largest / SLEW_UM_PER_S, abs=LATE_S)
    assert [notice for notice in notices if not any(map(notice.text.says, PAUSES))] == []
