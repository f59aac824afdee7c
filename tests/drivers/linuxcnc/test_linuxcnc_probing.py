"""The probing request between driver, agent and talc_safe_point.ngc in the real LinuxCNC.

The tests show where it runs, how it ends, and that the part program finds everything as it was. Needs Debian's
linuxcnc-uspace.
"""

import time
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from drivers.agent.control import AgentControl
from drivers.base import SystemClock
from drivers.linuxcnc.settings import LinuxCncSettings
from drivers.nc import ProbingState, RequestStatus
from simulators.linuxcnc.machine import HURRY, MANUAL
from tests.benches.linuxcnc_bench import ANSWER_S, AgentBench, refusal, running, until, until_mark
from tests.benches.linuxcnc_foreign import allow

pytestmark = [pytest.mark.peer, pytest.mark.slow, pytest.mark.waits(30)]

FINAL = (ProbingState.DONE, ProbingState.REFUSED, ProbingState.FAILED)
PARAMETERS = (
    *("#5400", "#5401", "#5402", "#5403", "#5210", "#5211", "#5212", "#5213"),
    *("#<_coord_system>", "#<_imperial>", "#<_incremental>", "#<_tool_offset>", "#<_feed>", "#<_motion_mode>"),
)
"""Tool, its offsets, G92; coordinate system, units and modes."""


def told() -> str:
    """The part program puts the values in force for it on analog outputs."""
    return "".join(f"M68 E{10 + i} Q{name}\n" for i, name in enumerate(PARAMETERS))


PROGRAM = f"""\
T5 M6
G20 G91 G55 G43 H5
G92 X1 Y2 Z3
G1 X0.1 F10
{told()}M68 E9 Q1
M66 P3 L3 Q60
o<talc_safe_point> call
{told()}M68 E9 Q2
M66 P3 L4 Q60
o<talc_safe_point> call
M2
"""
"""Inches, relative, with offsets of all sorts; waits for input 3 before and after its first safe point."""
TOOLS = "T99 P99 Z40 D6 ;probe\nT5 P5 X2 Z17 D6 ;mill\n"


@pytest.fixture
async def bench(tmp_path: Path) -> AsyncIterator[AgentBench]:
    settings = {**HURRY, "PIVOT_X": 3, "PIVOT_Y": -4, "PIVOT_Z": -5, "FEED": 60, "FIND_FEED": 2000}
    async with running(tmp_path, settings, sphere=True, tools=TOOLS) as it:
        (tmp_path / "machine" / "nc" / "part.ngc").write_text(PROGRAM)
        yield it


async def reaches(bench: AgentBench, number: int, *states: ProbingState, limit_s: float = 240.0) -> RequestStatus:
    async def there() -> bool:
        return (await bench.nc.probing_status(number)).state in states

    await until(there, limit_s)
    return await bench.nc.probing_status(number)


async def told_at(bench: AgentBench, mark: float) -> list[float]:
    """PARAMETERS when the part program has set its mark."""
    await until_mark(bench, mark)
    return [await bench.operator.number("getp", f"motion.analog-out-{10 + i}") for i in range(len(PARAMETERS))]


async def test_a_cycle_at_a_safe_point_restores_the_state_of_the_part_program(bench: AgentBench) -> None:
    await bench.operator.ask("run", "part.ngc")
    before = await told_at(bench, 1)
    assert before[:4] == pytest.approx([5, 2, 0, 17])
    await bench.nc.request_probing(17)
    assert (await bench.nc.probing_status(17)).state is ProbingState.REQUESTED
    await bench.operator.ask("hal", "setp", "motion.digital-in-03", "1")
    done = await reaches(bench, 17, *FINAL)
    assert done.state is ProbingState.DONE
    assert await told_at(bench, 2) == pytest.approx(before)
    # The next safe point has nothing to do.
    await bench.operator.ask("hal", "setp", "motion.digital-in-03", "0")
    await until(lambda: bench.operator.sees(idle=True))
    assert await bench.nc.probing_status(17) == done
    assert done.spread_mm is not None
    assert done.spread_mm <= 1e-3  # one servo period's way at this feed
    # Where the sphere of an ideal machine is, whatever pivot and probe length are.
    assert done.centres_mm is not None
    ideal = [(120, 0, 80), (0, 120, 80), (-120, 0, 80), (0, -120, 80), (120, -80, 0), (120, 80, 0)]
    for centre, expected in zip(done.centres_mm, ideal, strict=True):
        assert centre == pytest.approx(expected, abs=2e-3)
    with refusal("number_again"):
        await bench.nc.request_probing(17)


async def test_without_a_program_it_starts_by_itself_only_where_that_is_allowed(bench: AgentBench) -> None:
    settings = bench.settings
    await bench.nc.close()
    impatient = AgentControl(
        LinuxCncSettings(key_file=settings.key_file, port=settings.port, timeout_s=ANSWER_S, request_valid_for_s=0.5),
        SystemClock(),
    )
    await impatient.connect()
    try:
        await impatient.request_probing(1)
    finally:
        await impatient.close()
    await bench.nc.connect()
    expired = await reaches(bench, 1, *FINAL)
    assert (expired.state, expired.code) == (ProbingState.REFUSED, "expired")
    assert (await bench.operator.ask("state"))["position"] == pytest.approx([0.0] * 5, abs=1e-6)
    await bench.operator.ask("loosen", 8.0)
    await bench.nc.request_probing(2)
    await allow(bench)
    loose = await reaches(bench, 2, *FINAL)
    assert loose.state is ProbingState.DONE
    assert loose.spread_mm == pytest.approx(8e-3, abs=1.5e-3)  # what the touches differ by
    assert (await bench.nc.probing_status(1)).state is ProbingState.IDLE
    # The next request comes while the first program still changes the tool: the mode from before both is given back.
    await bench.nc.request_probing(3)
    await reaches(bench, 3, ProbingState.RUNNING)
    await bench.nc.withdraw_probing(3)
    await until(lambda: bench.operator.sees(mode=MANUAL, idle=True))


async def test_while_somebody_moves_the_machine_by_hand_it_does_not_start_by_itself(bench: AgentBench) -> None:
    assert (await bench.snapshot()).cannot_probe_code == "may_start"
    await allow(bench)
    assert (await bench.snapshot()).cannot_probe_code == ""
    await bench.operator.ask("jog", 0.5)
    assert (await bench.snapshot()).cannot_probe_code == "moved_by_hand"
    await bench.nc.request_probing(1)
    assert await stays_requested(bench, 1)
    await bench.operator.ask("jog", 0.0)
    await reaches(bench, 1, ProbingState.RUNNING)
    assert (await bench.snapshot()).cannot_probe_code == ""
    await bench.nc.withdraw_probing(1)
    await reaches(bench, 1, *FINAL)
    await until(lambda: bench.operator.sees(mode=MANUAL, idle=True))

    await bench.operator.ask("mdi", "M3 S800")  # a mill may be in the part, wheel in hand
    assert (await bench.snapshot()).cannot_probe_code == "moved_by_hand"
    await bench.nc.request_probing(2)
    assert await stays_requested(bench, 2)
    await bench.operator.ask("mdi", "M5")
    await reaches(bench, 2, ProbingState.RUNNING)


async def stays_requested(bench: AgentBench, number: int) -> bool:
    """For many times as long as a start takes, by LinuxCNC's own clock; the agent takes a turn for each question."""
    end_s = await bench.time_s() + 0.5
    while await bench.time_s() < end_s:
        await bench.snapshot()
        if (await bench.nc.probing_status(number)).state is not ProbingState.REQUESTED:
            return False
    return True


async def test_every_way_to_end_without_a_result_is_reported(bench: AgentBench) -> None:
    await bench.nc.request_probing(1)
    await bench.nc.withdraw_probing(1)
    withdrawn = await reaches(bench, 1, *FINAL)
    assert (withdrawn.state, withdrawn.code) == (ProbingState.REFUSED, "withdrawn")

    await allow(bench)
    await bench.operator.ask("hal", "setp", "motion.switchkins-type", "1")
    await bench.nc.request_probing(7)
    refused = await reaches(bench, 7, *FINAL)
    assert (refused.state, refused.code) == (ProbingState.REFUSED, "kinematics")
    await bench.operator.ask("hal", "setp", "motion.switchkins-type", "0")

    await bench.nc.request_probing(2)
    await reaches(bench, 2, ProbingState.RUNNING)
    with refusal("under_way"):
        await bench.nc.request_probing(3)
    await bench.nc.withdraw_probing(2)
    assert (await reaches(bench, 2, *FINAL)).code == "withdrawn"
    await until(lambda: bench.operator.sees(mode=MANUAL, idle=True))

    await bench.operator.ask("mdi", "G20 G91 G55 G92 X1")
    before = await bench.operator.ask("state")
    await bench.nc.request_probing(4)
    await reaches(bench, 4, ProbingState.RUNNING)

    async def beside_the_sphere() -> bool:
        return float((await bench.operator.ask("state"))["position"][2]) < 200.0

    await until(beside_the_sphere)
    await bench.operator.ask("abort")
    stopped = await reaches(bench, 4, *FINAL)
    assert (stopped.state, stopped.code) == (ProbingState.FAILED, "stopped")
    await until(lambda: bench.operator.sees(idle=True, g5x_index=before["g5x_index"]))
    after = await bench.operator.ask("state")
    assert after["g92"] == pytest.approx(before["g92"])
    assert {200, 910} <= set(after["gcodes"])  # inches, relative
    # Whoever has stopped it takes the probe up; until then nothing begins by itself.
    assert (await bench.snapshot()).cannot_probe_code == "probe_is_low"
    await bench.nc.request_probing(9)
    assert await stays_requested(bench, 9)
    assert (await bench.operator.ask("state"))["position"] == pytest.approx(after["position"], abs=1e-6)
    await bench.operator.ask("mdi", "o<talc_retract> call")
    await until(lambda: bench.operator.sees(idle=True))
    up = (await bench.operator.ask("state"))["position"]
    assert (await bench.snapshot()).cannot_probe_code == "halted", "nobody has allowed it again"
    assert await stays_requested(bench, 9)
    assert (await bench.operator.ask("state"))["position"] == pytest.approx(up, abs=1e-6)
    await bench.nc.withdraw_probing(9)
    await allow(bench)

    await bench.operator.ask("hal", "setp", "sphere-touch.in1", "-1")  # somebody took the sphere away
    await bench.nc.request_probing(5)
    missed = await reaches(bench, 5, *FINAL)
    await until(lambda: bench.operator.sees(idle=True), 60.0)  # nobody would resume it after M0
    assert (missed.state, missed.code) == (ProbingState.FAILED, "no_sphere")

    at = (await bench.operator.ask("state"))["position"]
    await bench.operator.ask("hal", "setp", "sphere-touch.in1", "1e6")  # its wire is broken: it would not feel a touch
    await bench.nc.request_probing(8)
    dead = await reaches(bench, 8, *FINAL)
    assert (dead.state, dead.code) == (ProbingState.REFUSED, "probe_silent")
    assert (await bench.operator.ask("state"))["position"] == pytest.approx(at, abs=1e-6)

    await bench.operator.ask("estop")
    await bench.nc.request_probing(6)
    off = await reaches(bench, 6, *FINAL)
    assert (off.state, off.code) == (ProbingState.REFUSED, "not_ready")


async def test_after_an_error_of_the_interpreter_nothing_of_the_cycle_stays_in_force(
    bench: AgentBench, tmp_path: Path
) -> None:
    nc, hal = tmp_path / "machine" / "nc", bench.operator
    near = nc / "talc_near.ngc"
    near.write_text(near.read_text().replace("o<talc_check> call\n", "G1 X[1 / 0]\n"))
    (nc / "part.ngc").write_text("G20 G91 G55\nG92 X1\nM68 E9 Q1\no<talc_safe_point> call\nM68 E9 Q2\nM2\n")

    async def restored() -> bool:
        state = await hal.ask("state")
        g92 = pytest.approx([-25.4, 0.0, 0.0])  # X1 in inches, where X is 0
        return state["idle"] and state["g5x_index"] == 2 and state["g92"] == g92 and {200, 910} <= set(state["gcodes"])

    await bench.nc.request_probing(1)
    await hal.ask("run", "part.ngc")
    stopped = await reaches(bench, 1, *FINAL)
    assert (stopped.state, stopped.code) == (ProbingState.FAILED, "interpreter")
    assert await hal.number("getp", "motion.analog-out-09") == 1.0
    await until(restored, 30.0)
    await hal.ask("mdi", "M68 E9 Q#5381")
    assert await hal.number("getp", "motion.analog-out-09") == 0.0, "X of G59.3, where the cycle had its pivot"


async def test_after_a_failed_cycle_the_part_program_waits_for_the_operator(bench: AgentBench, tmp_path: Path) -> None:
    hal = bench.operator
    part = "M3 S800\nM8\nG55\nM68 E9 Q1\no<talc_safe_point> call\nM68 E9 Q2\nG4 P600\nM2\n"
    (tmp_path / "machine" / "nc" / "part.ngc").write_text(part)
    await hal.ask("hal", "setp", "sphere-touch.in1", "-1")  # somebody took the sphere away
    await bench.nc.request_probing(1)
    await hal.ask("run", "part.ngc")
    missed = await reaches(bench, 1, *FINAL)
    assert (missed.state, missed.code) == (ProbingState.FAILED, "no_sphere")

    async def goes_on() -> bool:
        return await hal.number("getp", "motion.analog-out-09") == 2.0

    async def waits_or_goes_on() -> bool:
        return await hal.sees(paused=True) or await goes_on()

    await until(waits_or_goes_on)
    assert await hal.sees(paused=True, turns=False, flood=False, g5x_index=2, tool=0)
    assert not await goes_on()
    await hal.ask("resume")
    await until(goes_on)
    assert await hal.sees(turns=True, flood=True)


async def test_after_a_withdrawn_cycle_no_spindle_starts_by_itself(bench: AgentBench, tmp_path: Path) -> None:
    hal = bench.operator

    async def goes_on() -> bool:
        return await hal.number("getp", "motion.analog-out-09") == 2.0

    async def waits_or_goes_on() -> bool:
        return await hal.sees(paused=True) or await goes_on()

    for number, begin in ((1, "M3 S800\n"), (2, "")):
        program = f"{begin}M68 E9 Q1\no<talc_safe_point> call\nM68 E9 Q2\nG4 P600\nM2\n"
        (tmp_path / "machine" / "nc" / "part.ngc").write_text(program)
        await bench.nc.request_probing(number)
        await hal.ask("run", "part.ngc")
        await reaches(bench, number, ProbingState.RUNNING)
        await bench.nc.withdraw_probing(number)
        withdrawn = await reaches(bench, number, *FINAL)
        assert (withdrawn.state, withdrawn.code) == (ProbingState.FAILED, "withdrawn")
        await until(waits_or_goes_on)
        if begin:
            assert not await goes_on()
            assert await hal.sees(turns=False)
            await hal.ask("resume")
            await until(goes_on)
        assert await hal.sees(turns=bool(begin))
        await hal.ask("abort")


async def test_without_a_probe_in_the_tool_table_no_program_is_disturbed(tmp_path: Path) -> None:
    """LinuxCNC would end the part program that asks for a tool it does not know."""
    async with running(tmp_path, HURRY, tools="T5 P5 Z17 D6 ;mill\n") as bench:
        await allow(bench)
        (tmp_path / "machine" / "nc" / "part.ngc").write_text("o<talc_safe_point> call\nM68 E9 Q1\nM2\n")
        assert (await bench.snapshot()).cannot_probe_code == "no_probe"
        await bench.nc.request_probing(1)
        missing = await reaches(bench, 1, *FINAL)
        assert (missing.state, missing.code) == (ProbingState.REFUSED, "no_probe")
        await bench.operator.ask("run", "part.ngc")
        await until(lambda: ran_to_its_end(bench))


async def ran_to_its_end(bench: AgentBench) -> bool:
    return await bench.operator.number("getp", "motion.analog-out-09") == 1.0


async def test_a_program_that_does_not_start_is_waited_for_only_ten_seconds(bench: AgentBench, tmp_path: Path) -> None:
    """10 s, by the agent's clock; on a busy computer later, as long as `reaches` waits."""
    (tmp_path / "machine" / "nc" / "talc_safe_point.ngc").unlink()
    await allow(bench)
    began = time.monotonic()
    await bench.nc.request_probing(1)
    never = await reaches(bench, 1, *FINAL)
    assert (never.state, never.code) == (ProbingState.REFUSED, "not_started")
    assert time.monotonic() - began >= 10.0
    await until(lambda: bench.operator.sees(mode=MANUAL, idle=True))
