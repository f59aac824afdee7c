"""A control's own values in the whole gateway: checked, polled, and polled again after its agent was away."""

import asyncio
import json
from pathlib import Path

import pytest

from drivers.base import Quality, Reading
from gateway.acquisition.acquisition import Acquisition
from gateway.acquisition.build import lines_of
from gateway.config.file import load
from gateway.config.rules import cautions
from gateway.runtime.clocks import RealClock
from tests.benches.fake_agent import KEY, Agent, serving

PROFILE = 'protocol = "agent"\ntitle = "drives"\nunit = "degC"\n[[value]]\nname = "drive-x.temperature"\n'
CONFIG = """[machine]
name = "mill"
[nc]
kind = "linuxcnc"
port = {port}
key_file = "talc.key"
[[bus]]
name = "control"
kind = "agent"
host = "{host}"
port = {port}
key_file = "talc.key"
[[device]]
name = "drives"
bus = "control"
profile = "drives.toml"
unit = 1
channels = {{ motor_x = 0 }}
"""


def written(folder: Path, port: int = 7621, host: str = "127.0.0.1") -> Path:
    (folder / "drives.toml").write_text(PROFILE)
    file = folder / "gateway.toml"
    file.write_text(CONFIG.format(port=port, host=host))
    return file


def test_the_agent_of_the_control_may_be_a_bus_too_and_its_key_is_looked_at(tmp_path: Path) -> None:
    (tmp_path / "talc.key").write_bytes(KEY)
    (tmp_path / "talc.key").chmod(0o600)
    assert cautions(load(written(tmp_path))) == []
    (tmp_path / "talc.key").chmod(0o644)
    told = [(problem.where, problem.what) for problem in cautions(load(written(tmp_path, host="192.168.0.20")))]
    assert [where for where, _ in told if "bus" in where] == ["bus 'control', host", "bus 'control', key_file"]
    assert "'192.168.0.20' is another computer: use a tunnel" in told[0][1]
    assert "can be read by other users" in told[1][1]


class Thermometer(Agent):
    """An agent with one temperature."""

    def __init__(self) -> None:
        super().__init__()
        self.answers[""] = {"version": 3, "capabilities": ["values"]}
        self.degC = 20.0

    def hear(self, line: bytes) -> bytes:
        names = json.loads(line.partition(b" ")[2]).get("names", ())
        self.answers["values"] = {"values": [self.degC] * len(names), "stale": ""}
        return super().hear(line)


@pytest.mark.simulated_time
async def test_an_agent_that_was_silent_is_read_again_by_itself(tmp_path: Path) -> None:
    agent, readings = Thermometer(), list[Reading]()
    async with serving(agent, tmp_path) as settings:
        clock = RealClock()
        lines = lines_of(load(written(tmp_path, settings.port)), clock)
        async with Acquisition(lines, clock, readings.extend, lambda _: None):
            await asyncio.sleep(3.5)
            assert [r.quality for r in readings] == [Quality.GOOD] * 4
            agent.thinks_s = 1e6
            await asyncio.sleep(20.0)
            silent = readings[4:]
            assert {r.quality for r in silent[1:]} == {Quality.COMM_FAULT}
            agent.thinks_s, agent.degC = 0.0, 35.0
            await asyncio.sleep(70.0)
    assert [(r.quality, r.value) for r in readings[-5:]] == [(Quality.GOOD, 35.0)] * 5
