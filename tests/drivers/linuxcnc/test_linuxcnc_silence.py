"""What begins and what ends by itself after a stop, and when the agent is silent, in the real LinuxCNC.

Needs Debian's linuxcnc-uspace. The pin talc.seen tells which of LinuxCNC's real-time seconds the agent has seen last.
"""

from pathlib import Path

import pytest

from drivers.nc import ProbingState, RequestStatus
from simulators.linuxcnc.machine import MANUAL
from tests.benches.linuxcnc_bench import AgentBench, until, until_mark
from tests.benches.linuxcnc_foreign import FINAL, LENGTH_MM, SAFE_MM, allow, disturbable

pytestmark = [pytest.mark.peer, pytest.mark.slow, pytest.mark.waits(30)]

SILENCE_S = 5.0
NOT_ALLOWED_ANY_MORE = 24
"""The program's number of the reason, see talc_check.ngc."""
PART = "M68 E9 Q1\nM66 P3 L3 Q600\no<talc_safe_point> call\nM68 E9 Q2\nM2\n"


async def time_leaps(bench: AgentBench) -> None:
    """The real-time seconds go on by more than the silence that is allowed, within milliseconds.

    So they do when a computer has stood still, and the real-time thread makes up for the periods that it has missed.
    """
    end_s = await bench.time_s() + 1.2 * SILENCE_S

    async def has_passed() -> bool:
        return await bench.time_s() >= end_s

    await bench.operator.ask("hal", "setp", "talc-time.in", "1000")
    await until(has_passed)
    await bench.operator.ask("hal", "setp", "talc-time.in", "1")


async def reaches(bench: AgentBench, number: int, *states: ProbingState) -> RequestStatus:
    async def there() -> bool:
        return (await bench.nc.probing_status(number)).state in states

    await until(there)
    return await bench.nc.probing_status(number)


async def test_a_linuxcnc_that_stood_still_does_not_take_its_agent_for_dead(tmp_path: Path) -> None:
    """A move ends meanwhile, and the program reads the time before the agent has looked: it goes on a moment later."""
    async with disturbable(tmp_path) as bench:
        await bench.nc.request_probing(1)
        await reaches(bench, 1, ProbingState.RUNNING)
        await until(lambda: _is_low(bench))
        for _ in range(2):
            for part in ("milltask", "talc_agent.py"):
                await bench.operator.ask("freeze", part)
            await bench.pass_time(0.3)
            await time_leaps(bench)
            for part in ("milltask", "talc_agent.py"):
                await bench.operator.ask("thaw", part)
                await bench.pass_time(0.3)
        assert (await bench.nc.probing_status(1)).state is ProbingState.RUNNING
        await bench.nc.withdraw_probing(1)
        assert (await reaches(bench, 1, *FINAL)).code == "withdrawn"


async def test_a_silent_agent_is_not_obeyed_and_its_cycle_goes_up(tmp_path: Path) -> None:
    async with disturbable(tmp_path) as bench:
        hal = bench.operator
        (tmp_path / "machine" / "nc" / "part.ngc").write_text(PART)

        async def comes_to_the_safe_point() -> None:
            await hal.ask("run", "part.ngc")
            await until_mark(bench, 1.0)
            await hal.ask("hal", "setp", "motion.digital-in-03", "1")

        await hal.ask("hal", "setp", "talc.may-start", "0")
        await bench.nc.request_probing(1)
        await until(lambda: _is(bench, "talc-request", 1.0))
        await hal.ask("freeze", "talc_agent.py")
        await time_leaps(bench)
        await comes_to_the_safe_point()
        await until(lambda: hal.sees(idle=True))
        assert await bench.pin("talc-answers") == 0.0, "not taken"
        assert await hal.number("getp", "motion.analog-out-09") == 2.0
        await hal.ask("hal", "setp", "motion.digital-in-03", "0")
        await comes_to_the_safe_point()
        await bench.pass_time(0.5)
        await hal.ask("thaw", "talc_agent.py")  # it lives, and was late
        await reaches(bench, 1, ProbingState.RUNNING)

        await until(lambda: _is_low(bench))
        await hal.ask("freeze", "talc_agent.py")
        await time_leaps(bench)
        await until(lambda: _is(bench, "talc-state", 5.0))
        assert await _height_mm(bench) == pytest.approx(SAFE_MM, abs=1e-3)
        await hal.ask("thaw", "talc_agent.py")
        silent = await reaches(bench, 1, *FINAL)
        assert (silent.state, silent.code) == (ProbingState.FAILED, "agent_silent")


async def test_after_a_stop_at_the_safe_height_nothing_begins_until_it_is_allowed_again(tmp_path: Path) -> None:
    """And then a cycle whose agent is killed goes up as soon as the machine may not move by itself any more."""
    async with disturbable(tmp_path) as bench:
        hal = bench.operator
        await hal.ask("mdi", "T99 M6")
        await hal.ask("mdi", f"G53 G0 Z{SAFE_MM + LENGTH_MM:g}")
        await hal.ask("hal", "setp", "motion.feed-hold", "1")
        at = (await hal.ask("state"))["position"]
        stops = (("send_abort", (), "stopped"), ("send_mode", (MANUAL,), "other_mode"), ("estop", (), "not_ready"))
        for number, (stop, arguments, code) in enumerate(stops, start=1):
            await bench.nc.request_probing(number)
            await reaches(bench, number, ProbingState.ACCEPTED)
            await hal.ask(stop, *arguments)
            stopped = await reaches(bench, number, *FINAL)
            assert (stopped.state, stopped.code) == (ProbingState.FAILED, code)
            if code == "not_ready":
                await hal.ask("switch_on")
            await until(lambda: hal.sees(idle=True))
            await bench.nc.request_probing(10 + number)
            for _ in range(5):
                assert (await bench.nc.snapshot()).cannot_probe_code == "halted"
                await bench.pass_time(0.1)
            assert (await bench.nc.probing_status(10 + number)).state is ProbingState.REQUESTED
            await bench.nc.withdraw_probing(10 + number)
            await allow(bench)
        assert (await hal.ask("state"))["position"] == pytest.approx(at, abs=1e-6)
        await hal.ask("hal", "setp", "motion.feed-hold", "0")

        await bench.nc.request_probing(4)
        await reaches(bench, 4, ProbingState.RUNNING)
        await until(lambda: _is_low(bench))
        await hal.ask("kill_agent")
        await hal.ask("hal", "setp", "talc.may-start", "0")
        await until(lambda: _is(bench, "talc-state", 5.0))
        assert await bench.pin("talc-reason") == NOT_ALLOWED_ANY_MORE
        assert await _height_mm(bench) == pytest.approx(SAFE_MM, abs=1e-3)


async def _is(bench: AgentBench, signal: str, value: float) -> bool:
    return await bench.pin(signal) == value


async def _height_mm(bench: AgentBench) -> float:
    return await bench.operator.number("gets", "z-drive") - LENGTH_MM


async def _is_low(bench: AgentBench) -> bool:
    """Beside or just over the sphere, where every move is short."""
    return await _height_mm(bench) < 100.0
