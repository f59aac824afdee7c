"""`probe --watch`: its figures, its fit on a small terminal, and its lines where there is no terminal."""

import asyncio
import os
import pty
import re
import struct
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from fcntl import ioctl
from functools import partial
from math import nan
from pathlib import Path
from signal import SIGINT
from termios import TIOCSWINSZ

import pytest

from drivers.base import Quality, SystemClock
from drivers.build import make_device
from gateway.acquisition.acquisition import Acquisition
from gateway.acquisition.line import Line
from gateway.commissioning.probe_watch import DeviceFigures, ProbeView
from gateway.model.sample import Sample
from simulators.devices import Adam6015, TcpHost
from simulators.devices.source import SensorFault
from tests.benches.buses import make_bus
from tests.benches.command import talc_gateway
from tests.benches.scripted_bus import ScriptedBus, ScriptedDevice, ScriptedPlant
from tests.benches.service_file import MACHINE, adam6015
from tests.benches.started import started
from tests.benches.stepped_clock import SteppedClock

# A source of values that counts how often its device was read, so that a test can wait for that.


class CountedSource:
    """The same values at each read."""

    def __init__(self, values: Sequence[float]) -> None:
        self._values, self._count, self._news = list(values), 0, asyncio.Event()

    def __call__(self) -> Sequence[float]:
        self._count += 1
        self._news.set()
        return self._values

    async def reads(self, count: int) -> None:
        """Wait until there were this many reads since the call."""
        wanted = self._count + count
        while self._count < wanted:
            self._news.clear()
            await self._news.wait()


NOW = datetime(2026, 1, 5, tzinfo=UTC)


def readings(
    channels: Sequence[str], at_s: float, quality: Quality = Quality.GOOD, detail: str = "", value: float = 20.0
) -> list[Sample]:
    number = value if quality is Quality.GOOD else nan
    return [Sample(channel, number, "degC", quality, NOW, at_s, detail, sequence=1) for channel in channels]


def watched() -> DeviceFigures:
    return DeviceFigures("rtd1", "rtu1", ("a", "b"))


def test_rate_and_jitter_are_those_of_the_answers() -> None:
    device = watched()
    for at_s in (0.0, 1.0, 2.0, 3.25, 4.0):
        device.take(readings(device.channels, at_s), at_s)
    assert device.rate_hz == pytest.approx(1.0)
    assert device.jitter_s == pytest.approx(0.25)
    assert (device.lost, device.good, device.complete) == (0, 2, True)


@pytest.mark.parametrize("ages_s", [(1.0, 2.0, 3.0, 4.0), (0.0, 100.0, 100.0, 0.0)], ids=["same value", "older"])
def test_values_older_than_their_reading_do_not_change_the_rate(ages_s: tuple[float, ...]) -> None:
    """For example the numbers of an MQTT topic state their own time, which may stand still or go back."""
    device = watched()
    device.take(readings(device.channels, 0.0), 0.0)
    for now_s, age_s in enumerate(ages_s, start=1):
        device.take(readings(device.channels, now_s - age_s), now_s)
    assert device.rate_hz == pytest.approx(1.0)
    assert device.jitter_s == pytest.approx(0.0)
    assert device.good_at["a"] == 4.0 - ages_s[-1], "the age of the value is its own"


async def test_healthy_devices_on_several_buses_have_no_jitter() -> None:
    """Each bus reads at once and then on its own share of the period: the step between does not come from the wire."""
    clock, lines = SteppedClock(), []
    for number in range(4):
        bus = ScriptedBus(f"bus{number}")
        lines.append(Line(bus, (ScriptedDevice(f"device{number}", clock, bus),), phase_s=number / 4))
    watch = ProbeView("mill", lines, clock.monotonic)
    async with Acquisition(lines, clock, watch.take, lambda _: None):
        await clock.run_until(0.1)
        assert [device.answered_at for device in watch.devices] == [0.0] * 4
        await clock.run_until(3.0)
    assert [device.jitter_s for device in watch.devices] == pytest.approx([0.0] * 4)
    assert [device.rate_hz for device in watch.devices] == pytest.approx([1.0] * 4)


def test_silent_device_counts_lost_periods_and_keeps_the_age_of_its_last_value() -> None:
    device = watched()
    device.take(readings(device.channels, 1.0), 1.0)
    for at_s in (2.0, 3.0):
        device.take(readings(device.channels, at_s, Quality.COMM_FAULT, "unit 1 did not answer"), at_s)
    assert (device.lost, device.error, device.error_at) == (2, "unit 1 did not answer", 3.0)
    assert device.answered_at == 1.0
    assert device.good_at == {"a": 1.0, "b": 1.0}


def test_broken_sensor_is_no_lost_period() -> None:
    device = watched()
    device.take([*readings(["a"], 1.0), *readings(["b"], 1.0, Quality.SENSOR_FAULT, "broken wire")], 1.0)
    assert (device.lost, device.good, device.error) == (0, 1, "b: broken wire")


async def test_a_value_goes_stale_while_a_read_hangs() -> None:
    plant = ScriptedPlant("a", "b")
    view = ProbeView("mill", [plant.line(read_limit_s=3600.0)], plant.clock.monotonic)
    device, good = view.devices[1], list[bool]()
    async with view.reading(plant.clock, plant.notices.append):
        await plant.clock.run_until(9.5)
        plant.devices["b"].hang = True
        for at_s in (9.6, 11.9, 12.1):
            await plant.clock.run_until(at_s)
            good.append(view.all_good)
            answered = device.periods
        assert good == [True, True, False], "at 11.9 only two periods are missing"
        assert "b_t: no new value for 3.0 s" in view.table(12.1, 80, 24).plain
        await plant.clock.run_until(13.1)
    assert {r.quality for device in view.devices for r in device.latest.values()} == {Quality.STALE}
    assert [device.good_at for device in view.devices] == [{"a_t": 10.0}, {"b_t": 9.0}]
    assert (device.periods, device.lost) == (answered, 0), "the read has not ended"


def big_watch() -> ProbeView:
    """Five devices with six channels each, as on a machine; the third is silent, one sensor is broken."""
    clock, lines = SystemClock(), []
    bus = make_bus("rtu1", "modbus_rtu", {"port": "/dev/null"})
    for number in range(1, 6):
        channels = {f"somewhere_on_the_machine_{number}_{i}": i for i in range(6)}
        lines.append(Line(bus, (make_device(f"rtd{number}", bus, "icpdas_m7015", number, channels, {}, clock),)))
    watch = ProbeView("mill", lines, lambda: 0.0)
    for device in watch.devices:
        silent = device.name == "rtd3"
        text = "bus rtu1, device rtd3: unit 3 did not answer within 0.5 s (check power, wiring, unit id and baud)"
        watch.take(
            readings(device.channels, 1.0, Quality.COMM_FAULT if silent else Quality.GOOD, text if silent else "")
        )
    last = watch.devices[-1]
    broken = readings(last.channels[-1:], 2.0, Quality.SENSOR_FAULT, "the module reports this input broken")
    watch.take([*readings(last.channels[:-1], 2.0), *broken])
    return watch


@pytest.mark.parametrize(("width", "height"), [(80, 24), (80, 40), (132, 24), (40, 30)])
def test_table_fits_the_terminal_and_shows_every_fault(width: int, height: int) -> None:
    lines = big_watch().table(5.0, width, height).plain.split("\n")
    assert len(lines) <= height
    assert max(map(len, lines)) <= width
    text = "\n".join(lines)
    assert re.findall(r"\d+ of \d+", text) == ["23 of 30"]
    assert text.count("comm_fault") == 6
    assert text.count("sensor_fault") == 1
    assert "unit 3 did not answer" in text


def test_what_has_no_room_is_counted() -> None:
    lines = big_watch().table(5.0, 80, 20).plain.split("\n")
    channels = lines[lines.index("") :]
    shown = sum(line.count("somewher…") for line in channels)
    assert 0 < shown < 30
    assert "hine_3_0 " in channels[1], "faults come first; names lose their middle"
    assert re.findall(r"\d+", lines[-1]) == [f"{30 - shown}", f"{30 - shown}"], "left out, and of them good"


def configured(folder: Path, port: int) -> str:
    fields = f"port = {port}\nperiod_s = 0.1\ntimeout_s = 5.0"
    file = folder / "gateway.toml"
    file.write_text(MACHINE + adam6015("bed = 0, column = 1", "127.0.0.1", fields), encoding="utf-8")
    return str(file)


@pytest.mark.slow
async def test_lines_show_values_and_problems_where_there_is_no_terminal(tmp_path: Path) -> None:
    source = CountedSource([20.0, 30.0, *[0.0] * 5])
    adam = Adam6015(source)
    adam.faults.set(1, SensorFault.OPEN)
    async with started(TcpHost({1: adam})) as port:
        file = configured(tmp_path, port)
        # Asked for the third time, it has taken the second answer.
        enough = partial(source.reads, 3)
        done = await talc_gateway("probe", file, "--watch", "--every", "0.5", interrupt=enough)
    *_, last = lines = done.out.splitlines()
    problems = [line.partition(" ")[2] for line in lines if "channel " in line]
    assert problems == [
        "channel column: sensor_fault: burnout: open circuit at this input; at or above the end of the input's range"
    ]
    assert "tcp1 adam: 1/2 good, " in last
    assert last.endswith("bed=20.00 column=sensor_fault")
    assert done.code == 3


async def test_table_is_drawn_on_a_terminal_until_ctrl_c(tmp_path: Path) -> None:
    host = TcpHost({1: Adam6015(lambda: [20.0, 30.0, *[0.0] * 5])})
    file = configured(tmp_path, await host.start())
    ours, theirs = pty.openpty()
    ioctl(ours, TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
    environment = {**os.environ, "TERM": "xterm"}
    for name in ("COLUMNS", "LINES"):
        environment.pop(name, None)
    wanted = (b"bed", b"20.00 degC", b"Hz")
    seen = bytearray()
    drawn = asyncio.Event()

    def read() -> None:
        seen.extend(os.read(ours, 65536))
        if all(text in seen for text in wanted):  # there is no rate before the second answer
            drawn.set()

    loop = asyncio.get_running_loop()
    loop.add_reader(ours, read)
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "gateway", "probe", file, "--watch"), stdout=theirs, stderr=theirs, env=environment
    )
    try:
        async with asyncio.timeout(300.0):
            await drawn.wait()
            process.send_signal(SIGINT)
            assert await process.wait() == 0
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
        loop.remove_reader(ours)
        os.close(ours)
        os.close(theirs)
        await host.stop()
