"""The emulated control as a program, and the rehearsal of docs/arming.md with a real gateway beside it."""

import asyncio
import logging
import math
import re
import runpy
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractAsyncContextManager, contextmanager
from pathlib import Path

import pytest

from gateway.commissioning.dry_run import dry_run
from gateway.config.file import parse
from gateway.model.events import GatewayEvent, MeasurementEnded
from gateway.model.probing import End, Outcome
from gateway.service.serving import serve
from simulators.devices import Adam6015, TcpHost
from simulators.nc import Activity, CycleSettings, DayPart, LoadCase, MeanLoads, Nck
from simulators.nc.alone import REFERENCE_CYCLES, ControlTold, GrowingTable, run_alone
from simulators.nc.nck import JOG, R_REQUEST
from simulators.nc.watchdog import R_BEAT, R_OWNER, R_RAMP, R_SILENCE
from tests.benches.command import LIMIT_S, beside, here
from tests.benches.free_port import free_port
from tests.benches.service_file import MACHINE, adam6015
from tests.benches.simulated_time import jump_wall_clock
from tests.benches.small_run import START
from tests.benches.soak import RightClock
from tests.benches.started import started

PAGE = Path(__file__).parents[3] / "docs" / "arming.md"
REFERENCE_S = 90.0
"""About how long the first five cycles of the page's rehearsal take; the table is still until then."""
SHIFTED = re.compile(r"shifted by X (\S+), Y (\S+), Z (\S+) µm")
QUICKLY = """
[storage]
path = "rehearsal.sqlite"
[grid]
step_s = 1.0
[talc.learner]
shortest_interval_steps = 2
longest_interval_steps = 3
[compensation]
mode = "compensate"
slew_um_per_s = 10.0
watchdog_s = 4.0
"""
NC, PROBING = (
    "period_s = 0.2\ntimeout_s = 30.0\n",
    """armed = true
lead_s = 0.0
poll_s = 0.2
prefer_idle_s = 0.0
pause_s = 0.0
surprise_sigmas = 1000.0
""",
)
"""The printed lines, with a gateway that learns in seconds instead of hours."""


class Program:
    """A process and what it has printed."""

    def __init__(self, process: "subprocess.Popen[bytes]", out: Path) -> None:
        self.process, self._out = process, out

    def lines(self) -> list[str]:
        return self._out.read_text("utf-8").splitlines()

    def until(self, holds: Callable[[list[str]], bool]) -> list[str]:
        """What it has printed, once this condition holds."""
        end = time.monotonic() + LIMIT_S
        while not holds(lines := self.lines()):
            assert self.process.poll() is None, "\n".join(lines)
            assert time.monotonic() < end, "\n".join(lines)
            time.sleep(0.1)
        return lines


@contextmanager
def program(out: Path, *arguments: str) -> Iterator[Program]:
    """`python -m` with these, killed at the end unless it has ended."""
    with out.open("wb") as file:
        process = subprocess.Popen([sys.executable, "-m", *arguments], stdout=file, stderr=subprocess.STDOUT)
    try:
        yield Program(process, out)
    finally:
        process.kill()
        process.wait()


def adam() -> AbstractAsyncContextManager[int]:
    """A thermometer module at rest; its TCP port."""
    return started(TcpHost({1: Adam6015(lambda: [20.0] * 7)}))


def sensors(telemetry: str, modbus: int) -> str:
    module = adam6015("column = 0, table = 1", "127.0.0.1", f"port = {modbus}")
    return f"{MACHINE}[telemetry]\n{telemetry}\n{module}"


def last_shift(lines: list[str]) -> tuple[float, ...]:
    found = [SHIFTED.search(line) for line in lines]
    return tuple(map(float, ([f.groups() for f in found if f] or [("0", "0", "0")])[-1]))


def chosen() -> str:
    """What the page adds to the lines that the control prints."""
    rehearsal = PAGE.read_text("utf-8").partition("## Rehearse")[2]
    return rehearsal.partition("```toml\n")[2].partition("```")[0]


def hears_nothing(lines: list[str]) -> bool:
    """The last line that the watchdog printed."""
    return "receives nothing" in [line for line in lines if "the watchdog receives" in line][-1]


@pytest.mark.slow
def test_the_rehearsal_of_the_page(tmp_path: Path) -> None:
    """The table moves in Y and Z: the tool follows, and goes back after the gateway was killed."""
    file, port = tmp_path / "rehearsal.toml", free_port()
    command = ("simulators.nc", "--port", str(port), "--cycle-s", "0.5", "--warm-s", "5")
    with beside(adam()) as modbus, program(tmp_path / "nc", *command) as control:
        printed = control.until(lambda lines: any(line.startswith("# ready") for line in lines))
        lines = "\n".join(line for line in printed if not line.startswith("#"))
        lines = lines.replace("[nc]\n", f"[nc]\n{NC}").replace("[probing]\n", f"[probing]\n{PROBING}")
        telemetry = f'listen = ["tcp/127.0.0.1:{free_port()}"]'
        file.write_text(sensors(telemetry, modbus) + lines + QUICKLY, encoding="utf-8")
        assert "compensation compensate, probing armed" in here("check", str(file)).out
        assert "no dry run" in here("check", str(file)).out
        driven = here("nc", "dry-run", str(file))
        assert driven.code == 0, driven.together
        assert "no dry run" not in here("check", str(file)).out
        probed = here("probe", str(file), "--try-writing")
        assert (probed.code, "everything that is needed" in probed.out) == (0, True), probed.together
        with program(tmp_path / "gateway", "gateway", "run", str(file)) as gateway:
            followed = control.until(lambda lines: max(last_shift(lines)) > 1.0)
            assert "compensation compensate, probing armed" in here("status", str(file)).out
            gateway.process.kill()
            control.until(lambda lines: hears_nothing(lines) and last_shift(lines) == (0.0, 0.0, 0.0))
        control.process.send_signal(signal.SIGTERM)
        assert control.process.wait(LIMIT_S) == 0
        assert control.lines()[-1] == "# ended"
    assert any("claimed by gateway" in line for line in followed)
    assert abs(last_shift(followed)[0]) < 2.0, "the table does not move in X"


@pytest.mark.slow
@pytest.mark.simulated_time
async def test_monitor_and_advise_learn_what_compensate_corrects(tmp_path: Path) -> None:
    """With the page's own settings, one database and one control; nothing is written before the third mode."""
    page = re.search(r"simulators.nc --port 4841 --cycle-s (\d+) --warm-s (\d+)", PAGE.read_text("utf-8"))
    assert page is not None
    cycle_s, warm_s = map(float, page.groups())
    jump_wall_clock(int(START - time.time()))
    await asyncio.sleep(math.ceil(time.time()) - time.time())  # to begin at the same moment of a grid step each time
    told, stop, outcomes = list[str](), asyncio.Event(), list[Outcome]()

    def see(event: GatewayEvent) -> None:
        if isinstance(event, MeasurementEnded):
            outcomes.append(event.outcome)

    port = free_port()
    cycle = CycleSettings(radius_mm=200.0, height_mm=80.0, duration_s=cycle_s, approach_s=cycle_s / 12.0)
    control = asyncio.create_task(run_alone(cycle, warm_s, port, told.append, stop))
    while not told:
        await asyncio.sleep(0.1)
    async with adam() as modbus:
        text = sensors("enabled = false", modbus) + f"{told[0]}\n{chosen()}"
        await dry_run(parse(text, tmp_path / "rehearsal.toml"), RightClock(), 50.0, 1.0, print)
        began_s = time.monotonic()
        for mode, for_s in (("monitor", 150.0), ("advise", 120.0), ("compensate", 120.0)):
            assert not any("claimed" in line or "shifted" in line for line in told), f"before {mode}"
            config, ends = (
                parse(text.replace('"compensate"', f'"{mode}"'), tmp_path / "rehearsal.toml"),
                asyncio.Event(),
            )
            assert config.compensation.mode == mode
            running = asyncio.create_task(serve(config, RightClock(), ends, simulated=False, more=[see]))
            await asyncio.wait([running], timeout=for_s)
            corrected, warm = last_shift(told), 1.0 - math.exp(-(time.monotonic() - began_s - REFERENCE_S) / warm_s)
            ends.set()
            await running
    await asyncio.sleep(1.0)
    stop.set()
    await control
    assert [outcome for outcome in outcomes if outcome.end is not End.MEASURED] == [], "no surprise"
    for shift_um, growth_um in zip(corrected, (0.0, 4.0 * warm, 6.0 * warm), strict=True):
        assert abs(growth_um - shift_um) < max(1.0, growth_um / 2.0), "less than half of it is left"
    assert last_shift(told) == (0.0, 0.0, 0.0), "taken back at the end"


def test_what_a_gateway_does_is_reported_once() -> None:
    rest = LoadCase([DayPart(0.0, 1.0, Activity.PAUSE, MeanLoads())])
    table, told = GrowingTable(300.0), ControlTold()
    nck = Nck(table, rest, cycle=CycleSettings(duration_s=12.0, approach_s=1.0))

    def news(now_s: float) -> list[str]:
        nck.advance(now_s)
        return told.news(nck, now_s)

    assert news(0.0) == []
    for number, value in ((R_SILENCE, 10.0), (R_RAMP, 1e-3), (R_OWNER, 7.0), (R_BEAT, 1.0)):
        nck.write_r(number, value, 1.0)
    assert news(1.0) == [
        "claimed by gateway 7 (R93)",
        "the watchdog receives the gateway's beat (R96 = 1): offsets may be written",
    ]
    nck.write_k0(2, -0.004, 2.0)
    assert news(2.0) == ["the tool is shifted by X +0.0, Y +0.0, Z +4.0 µm"]
    nck.write_k0(2, -0.0041, 3.0)
    assert news(3.0) == [], "less than half a micrometre"
    nck.write_r(R_REQUEST, 5.0, 4.0)
    assert news(4.0) == ["probing cycle 5 is requested (R60)", "probing cycle 5 is accepted (R65 = 1)"]
    assert news(6.0) == ["probing cycle 5 is running (R65 = 2)"]
    nck.set_mode(JOG, 7.0)
    assert news(7.0) == ["probing cycle 5 is failed (R65 = 5): wrong mode (R66 = 3)"]
    assert news(12.0) == [
        "the watchdog receives nothing (R96 = 2), no beat for 10 s: it takes the offsets back",
        "the tool is shifted by X +0.0, Y +0.0, Z +3.1 µm",
    ]
    assert news(20.0) == ["the tool is shifted by X +0.0, Y +0.0, Z +0.0 µm"]
    nck.write_r(R_OWNER, 0.0, 21.0)
    assert news(21.0) == ["released by gateway 7"]


def test_the_table_moves_from_the_end_of_the_reference_on() -> None:
    """A first-order lag: 1 - 1/e of the way after its time constant."""
    table = GrowingTable(300.0)
    table.cycles = [(20.0 * k, 20.0 * k + 10.0) for k in range(REFERENCE_CYCLES - 1)]
    assert table.tool_deviation_um(5000.0) == (0.0, 0.0, 0.0)
    table.cycles.append((90.0, 100.0))
    assert table.tool_deviation_um(100.0) == (0.0, 0.0, 0.0)
    assert table.tool_deviation_um(400.0) == pytest.approx((0.0, 4.0 * 0.63212, 6.0 * 0.63212), rel=1e-5)
    assert table.tool_deviation_um(5000.0) == pytest.approx((0.0, 4.0, 6.0), abs=1e-4)


def test_a_port_that_is_taken_is_named(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str]
) -> None:
    caplog.set_level(logging.getLogger("asyncua").level, "asyncua")  # set back at the end
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        monkeypatch.setattr(sys, "argv", ["nc", "--port", str(port)])
        with pytest.raises(SystemExit) as ended:
            runpy.run_module("simulators.nc", run_name="__main__")
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert str(port) in said
    assert "choose another --port" in said.splitlines()[-1]
