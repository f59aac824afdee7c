"""What a control's agent reports as channels: absent, no number, invalid, old; on a fake agent in simulated time."""

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from drivers.base import BadAnswer, Bus, ConnectError, Driver, Quality, SetupError, SystemClock, WrongDevice
from drivers.build import make_device
from tests.benches.buses import make_bus
from tests.benches.driver_reads import told
from tests.benches.fake_agent import Agent, serving
from tests.benches.refusals import refusing

pytestmark = pytest.mark.simulated_time

PROFILE = """
protocol = "agent"
title = "what the control knows"
unit = "degC"
max_age_s = 10
[[value]]
name = "motor"
scale = 0.5
offset = -1.0
[[value]]
name = "bearing"
valid = "bearing.ok"
error = "bearing.errors"
[[value]]
name = "load"
unit = "%"
alive = "count"
"""
NAMES = ["motor", "bearing", "bearing.ok", "bearing.errors", "load", "count"]
GREETING = {"version": 3, "capabilities": ["values"]}


class KnowingAgent(Agent):
    """Has its control's values by name; any other name is absent."""

    def __init__(self) -> None:
        super().__init__()
        self.now: dict[str, object] = {
            "motor": 81.0, "bearing": 40.0, "bearing.ok": 1.0, "bearing.errors": 0.0, "load": 55.0, "count": 0.0
        }  # fmt: skip
        self.stale = ""
        self.answers[""] = GREETING
        self.instead: object = None
        """Replaces the answer to `values`."""

    def hear(self, line: bytes) -> bytes:
        names = json.loads(line.partition(b" ")[2]).get("names", ())
        right = {"values": [self.now.get(name) for name in names], "stale": self.stale}
        self.answers["values"] = right if self.instead is None else self.instead
        return super().hear(line)


@asynccontextmanager
async def device_at(
    folder: Path, text: str = PROFILE, count: int = 3
) -> AsyncIterator[tuple[KnowingAgent, Bus, Driver]]:
    """The bus is not connected yet."""
    agent = KnowingAgent()
    path = folder / "control.toml"
    path.write_text(text)
    async with serving(agent, folder) as settings:
        bus = make_bus("nc1", "agent", {"port": settings.port, "key_file": str(settings.key_file), "timeout_s": 5.0})
        device = make_device("knows", bus, str(path), 1, {f"c{i}": i for i in range(count)}, {}, SystemClock())
        try:
            yield agent, bus, device
        finally:
            await bus.close()


async def test_each_value_that_is_not_good_is_named_and_takes_its_own_channel_only(tmp_path: Path) -> None:
    async with device_at(tmp_path) as (agent, bus, device):
        await bus.connect()
        assert agent.heard[0]["reads"] is True, "it logs in as a client that only reads"
        await device.connect()
        await device.read()
        agent.now["count"] = 1.0
        assert told(await device.read()) == [(39.5, "degC"), (40.0, "degC"), (55.0, "%")]
        assert agent.heard[-1] == {"do": "values", "names": NAMES}, "one question"

        expected = {
            ("motor", None): (0, "comm_fault", "the control has nothing named motor: compare the name"),
            ("motor", "nan"): (0, "sensor_fault", "motor holds no finite number: nan"),
            ("bearing.ok", 0.0): (1, "sensor_fault", "bearing.ok is FALSE"),
            ("bearing.ok", None): (1, "comm_fault", "the control has nothing named bearing.ok"),
            ("bearing.errors", 3.0): (1, "sensor_fault", "bearing.errors = 3"),
            ("bearing.errors", "inf"): (1, "sensor_fault", "bearing.errors holds no finite number: inf"),
            ("count", None): (2, "comm_fault", "the control has nothing named count"),
        }
        for (name, value), (number, quality, detail) in expected.items():
            before = agent.now[name]
            agent.now[name] = value
            readings = await device.read()
            agent.now[name] = before
            found = {r.channel: (r.quality.value, r.detail) for r in readings if r.quality is not Quality.GOOD}
            assert list(found) == [f"c{number}"], f"{name} = {value!r}"
            assert found[f"c{number}"][0] == quality
            assert found[f"c{number}"][1].startswith(detail)


async def test_a_value_whose_source_has_stopped_counting_is_stale(tmp_path: Path) -> None:
    async with device_at(tmp_path) as (agent, bus, device):
        await bus.connect()
        await device.connect()
        assert told(await device.read())[2] == ("stale", "count has not changed since the gateway began to read it")
        agent.now["count"] = 1.0
        assert told(await device.read())[2] == (55.0, "%")
        await asyncio.sleep(9.0)
        assert told(await device.read())[2] == (55.0, "%")
        await asyncio.sleep(2.0)
        assert told(await device.read())[2] == ("stale", "count has not changed for 11 s")
        agent.now["count"] = 0.0
        assert told(await device.read())[2] == (55.0, "%"), "a counter may begin again"


async def test_values_of_a_control_that_stands_still_are_stale_and_worse_ones_stay_worse(tmp_path: Path) -> None:
    async with device_at(tmp_path) as (agent, bus, device):
        await bus.connect()
        agent.stale, agent.now["bearing"] = "the control stands still", None
        qualities = [r.quality for r in await device.read()]
        assert qualities == [Quality.STALE, Quality.COMM_FAULT, Quality.STALE]
        assert told(await device.read())[0] == ("stale", "the control stands still")


async def test_a_device_of_which_the_control_has_nothing_is_refused_by_name(tmp_path: Path) -> None:
    async with device_at(tmp_path) as (agent, bus, device):
        await bus.connect()
        agent.now = {"bearing.ok": 1.0}
        with pytest.raises(
            WrongDevice, match=r"bus nc1, device knows: the control has nothing named motor, bearing, load"
        ):
            await device.connect()
        agent.now["load"] = 1.0
        await device.connect()


async def test_an_agent_that_reports_no_values_is_refused(tmp_path: Path) -> None:
    async with device_at(tmp_path) as (agent, bus, _):
        agent.answers[""] = {"version": 3, "capabilities": ["shift"]}
        for _ in range(2):  # it is not left connected: an older agent would keep the writing client out
            with pytest.raises(WrongDevice) as refused:
                await bus.connect()
            assert (refused.value.bus, refused.value.what.code) == ("nc1", "agent_no_values")
            assert refused.value.hint.code == "agent_needs_values"


async def test_more_names_than_a_line_holds_are_several_questions(tmp_path: Path) -> None:
    names = [f"{'long-' * 30}{i:03}" for i in range(60)]
    text = PROFILE.split("[[value]]")[0] + "".join(f'[[value]]\nname = "{name}"\n' for name in names)
    async with device_at(tmp_path, text, 60) as (agent, bus, device):
        agent.now = {name: float(i) for i, name in enumerate(names)}
        await bus.connect()
        assert [r.value for r in await device.read()] == [float(i) for i in range(60)]
        asked = [message["names"] for message in agent.heard if message.get("do") == "values"]
        assert len(asked) > 1
        assert [name for part in asked if isinstance(part, list) for name in part] == names
        assert max(len(str(message)) for message in agent.heard) + 65 < 4096


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"values": [1.0], "stale": ""}, "expected a list of 6"),
        ({"values": [1.0, True, 1.0, 1.0, 1.0, 1.0], "stale": ""}, "value bearing = True: expected a finite number"),
        ({"values": [1.0] * 6}, "stale = None: expected a text"),
        ([1.0] * 6, "values: expected an object"),
    ],
)
async def test_an_answer_of_another_form_is_no_value(wrong: object, says: str, tmp_path: Path) -> None:
    async with device_at(tmp_path) as (agent, bus, device):
        await bus.connect()
        agent.instead = wrong
        with pytest.raises(BadAnswer, match=f"bus nc1, device knows: .*{says}"):
            await device.read()


async def test_a_connection_that_was_lost_is_reported_and_opened_again(tmp_path: Path) -> None:
    async with device_at(tmp_path) as (agent, bus, device):
        with pytest.raises(ConnectError, match="bus nc1, device knows: not connected"):
            await device.read()
        await bus.connect()
        agent.says = [b"0" * 64 + b' {"answer": 1}\n']
        with pytest.raises(WrongDevice, match=r"bus nc1, device knows: .*is not the agent with this key"):
            await device.read()
        await bus.connect()
        assert len(await device.read()) == 3


def test_a_source_that_counts_needs_the_time_that_it_may_rest(tmp_path: Path) -> None:
    (tmp_path / "control.toml").write_text(PROFILE.replace("max_age_s = 10\n", ""))
    bus = make_bus("nc1", "agent", {"key_file": str(tmp_path / "key")})
    with refusing(SetupError, "value[2].alive: agent_alive_alone"):
        make_device("knows", bus, str(tmp_path / "control.toml"), 1, {"load": 2}, {}, SystemClock())
