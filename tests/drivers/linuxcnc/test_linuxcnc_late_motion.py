"""LinuxCNC's program reads the state from between a command and its motion, as now and then on a busy computer.

Then M66 gives the position from before the motion. Needs Debian's linuxcnc-uspace and linuxcnc-uspace-dev.
"""

import asyncio
import shutil
from pathlib import Path

import pytest

from simulators.linuxcnc.machine import HURRY
from tests.benches import linuxcnc_bench
from tests.benches.linuxcnc_bench import running, until

pytestmark = [pytest.mark.peer, pytest.mark.slow, pytest.mark.waits(20)]

_COMPONENT = Path(linuxcnc_bench.__file__).parent / "late_motion.comp"
_MOVES, _MOST = 60, 3000  # on, as long as it has not happened yet: seldom with both cores busy
_PROGRAM = f"""\
o<late> sub
#<_talc_dry> = 0
#<_talc_request> = 1
#<_talc_reason> = 0
o<talc_begin> call
#<old> = 0
#<alarms> = 0
#<n> = 0
o1 while [[#<n> LT {_MOVES}] OR [[#<old> EQ 0] AND [#<n> LT {_MOST}]]]
  #<n> = [#<n> + 1]
  #<_talc_px> = [10 * [#<n> MOD 2]]
  G0 X#<_talc_px>
  o2 if [#<n> MOD 3 EQ 0]
    M66 E41 L0
    o3 if [ABS[#<_x> - #<_talc_px>] GT 0.002]
      #<old> = [#<old> + 1]
    o3 endif
    o<talc_wait> call
  o2 else
    o<talc_check> call
    #<alarms> = [#<alarms> + #<_talc_reason>]
    #<_talc_reason> = 0
  o2 endif
o1 endwhile
#<_talc_px> = [#<_talc_px> + 0.01]
o<talc_check> call
M68 E10 Q#<old>
M68 E11 Q#<alarms>
M68 E12 Q#<_talc_reason>
M68 E9 Q#<n>
o<late> endsub
M2
"""
_OTHERS = 21


async def test_a_motion_that_begins_late_is_no_alarm_and_what_has_moved_is_one(tmp_path: Path) -> None:
    async with running(tmp_path, HURRY, tools="T99 P99 Z40 D6 ;probe\n") as bench:
        hal, modules = bench.operator, tmp_path / "machine" / "modules"
        shutil.copy(_COMPONENT, modules)
        compiler = await asyncio.create_subprocess_exec("halcompile", "--compile", _COMPONENT.name, cwd=modules)
        assert await compiler.wait() == 0
        await hal.ask("hal", "loadrt", "late_motion")
        await hal.ask("hal", "addf", "late-motion", "servo-thread", "2")  # after the commands, before the motions
        (tmp_path / "machine" / "nc" / "late.ngc").write_text(_PROGRAM)
        await hal.ask("mdi", "T99 M6")
        await hal.ask("send_mdi", "o<late> call")

        async def over() -> bool:
            return await hal.number("getp", "motion.analog-out-09") >= _MOVES

        await until(over)
        old, alarms, reason = [await hal.number("getp", f"motion.analog-out-{i}") for i in (10, 11, 12)]
    assert old > 0, "it does happen here"
    assert alarms == 0
    assert reason == _OTHERS
