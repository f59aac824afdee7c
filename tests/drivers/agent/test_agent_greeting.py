"""What an agent says about itself decides what is asked of it; what does not fit is refused by name."""

from pathlib import Path
from typing import Any

import pytest

from drivers.agent.control import AgentControl
from drivers.agent.settings import AgentSettings
from drivers.base import BadAnswer, DriverError, Refused, SetupError, SystemClock, WrongDevice
from drivers.nc import LinearOffsets, NotSendable, WatchdogTerms
from drivers.problems import settings_of
from tests.benches.fake_agent import agent_and_driver
from tests.benches.reference_agent import POSES_DEG, REFERENCE, served_agent
from tests.benches.refusals import refusing

pytestmark = pytest.mark.simulated_time

TRAVEL = {"pairs": ["XX", "XY", "YX"], "reference_mm": [10, 0, 0], "reach_mm": [300, 200, 100]}
FLAT = ((0.0, 0.0, 0.0),) * 3


def test_a_cycle_without_poses_is_refused_before_any_agent_is_asked() -> None:
    with refusing(SetupError, "poses: expected value=0 at_least limit=1"):
        settings_of(AgentSettings, {"key_file": Path("talc.key"), "poses": 0})


@pytest.mark.parametrize(
    ("greeting", "error", "says"),
    [
        ({"version": 4}, WrongDevice, "agent_newer version=4 own=3 update_gateway"),
        ({"version": "3"}, BadAnswer, "agent_version version='3'"),
        ({"version": True}, BadAnswer, "agent_version version=True"),
        ({"version": 3, "capabilities": "probe"}, BadAnswer, "agent_capabilities told='probe'"),
        (
            {"version": 3, "capabilities": ["probe"]},
            BadAnswer,
            "agent_no_number what=poses value=None agent_version_differs",
        ),
        (
            {"version": 3, "capabilities": ["probe"], "poses": 5},
            WrongDevice,
            "agent_pose_count count=5 poses=6 agent_poses_hint",
        ),
        (
            {"version": 3, "capabilities": ["probe"], "poses": [[0, 0, 0]]},
            BadAnswer,
            "agent_numbers what=poses count=2 agent_version_differs",
        ),
        ({"version": 3, "capabilities": ["probe"], "poses": 6, "path": 7}, BadAnswer, "agent_path told=7"),
        ({"version": 3, "capabilities": ["probe"], "poses": 6, "path": "x" * 65}, BadAnswer, "agent_path most=64"),
        ({"version": 3, "capabilities": ["slopes"]}, BadAnswer, "agent_no_object what=travel agent_version_differs"),
        ({"capabilities": ["slopes"], "travel": {**TRAVEL, "pairs": ["XA"]}}, BadAnswer, "agent_pairs"),
        ({"capabilities": ["slopes"], "travel": {**TRAVEL, "reach_mm": [1, 0, 1]}}, BadAnswer, "agent_travel_reach"),
    ],
)
async def test_a_greeting_that_cannot_be_used_names_the_field(
    greeting: object, error: type[DriverError], says: str, tmp_path: Path
) -> None:
    async with agent_and_driver(tmp_path) as (agent, nc):
        agent.answers[""] = greeting
        with refusing(error, says):
            await nc.connect()
        with refusing(DriverError, "not_connected connect_first"):
            await nc.snapshot()


async def test_an_agent_that_touches_other_poses_is_refused_and_a_whole_turn_is_none(tmp_path: Path) -> None:
    async with served_agent(REFERENCE.Machine()) as served:
        turned = tuple((a, c - 360.0) for a, c in POSES_DEG)
        settings = served.settings(tmp_path)
        await connected_and_closed(AgentControl(settings.model_copy(update={"poses_deg": turned}), SystemClock()))
        other = (*POSES_DEG[:4], (-90.0, 0.0), (90.0, 0.0))
        with refusing(WrongDevice, "agent_pose i=5 found=A_90_C_0 other=A_-90_C_0 agent_poses_hint"):
            await AgentControl(settings.model_copy(update={"poses_deg": other}), SystemClock()).connect()


async def connected_and_closed(nc: AgentControl) -> None:
    await nc.connect()
    await nc.close()


async def test_an_agent_that_only_reports_is_read_and_never_written_to(tmp_path: Path) -> None:
    async with agent_and_driver(tmp_path) as (agent, nc):
        agent.answers[""] = {"version": 3, "capabilities": []}
        del agent.answers["read"]
        await nc.connect()
        assert (await nc.snapshot()).cannot_probe == "the agent has no probing cycle"
        assert await nc.read_compensation() == (0.0, 0.0, 0.0)
        with refusing(Refused, "agent_no_offsets mode_works"):
            await nc.claim(7, WatchdogTerms(10.0, 1.0))
        assert {message.get("do") for message in agent.heard} == {None, "status", "read"}


async def test_an_agent_that_offers_no_dry_run_is_asked_for_none(tmp_path: Path) -> None:
    """It does not know the height, and would touch."""
    async with agent_and_driver(tmp_path) as (agent, nc):
        agent.answers |= {"": {"version": 3, "capabilities": ["probe"], "poses": 6}, "probe": None}
        await nc.connect()
        assert not nc.runs_dry
        with pytest.raises(Refused):
            await nc.request_probing(4, 50.0)
        assert "probe" not in {message.get("do") for message in agent.heard}
        await nc.request_probing(4)
        assert "probe" in {message.get("do") for message in agent.heard}


@pytest.mark.parametrize(
    ("told", "ready"),
    [
        ({"estop": False, "on": True, "homed": True}, True),
        ({"estop": True, "on": True, "homed": True}, False),
        ({"estop": False, "on": True}, False),
        ({"on": True, "homed": True}, False),
        ({"estop": False, "on": "yes", "homed": 1}, False),
    ],
)
async def test_a_machine_is_ready_only_when_the_agent_says_so(
    told: dict[str, Any], ready: bool, tmp_path: Path
) -> None:
    async with agent_and_driver(tmp_path) as (agent, nc):
        status = {"positions": dict.fromkeys("XYZAC", 0.0), "states": {}, "alarms": [700]}
        agent.answers["status"] = status | told
        snapshot = await nc.snapshot()
        assert snapshot.ready is ready
        assert snapshot.alarms == ((1,) if told.get("estop") else ()) + (700,)


@pytest.mark.parametrize("alarms", [700, [True], [700, "hot"], [[700]]])
async def test_alarms_that_are_no_whole_numbers_are_refused(alarms: Any, tmp_path: Path) -> None:
    async with agent_and_driver(tmp_path) as (agent, nc):
        agent.answers["status"] = {"positions": dict.fromkeys("XYZAC", 0.0), "states": {}, "alarms": alarms}
        with refusing(BadAnswer, "agent_alarms"):
            await nc.snapshot()


async def test_slopes_go_to_an_agent_that_has_them_and_come_back(tmp_path: Path) -> None:
    async with agent_and_driver(tmp_path) as (agent, nc):
        agent.answers |= {
            "": {"version": 3, "capabilities": ["slopes"], "travel": TRAVEL},
            "heartbeat": True,
            "slopes": {"um": [1.0, 0.0, 0.0], "um_per_mm": [[0.02, 0, 0], [0, 0, 0], [0, 0, 0]]},
        }
        await nc.connect()
        slopes = nc.slopes
        assert slopes is not None
        assert (slopes.pairs, slopes.reference_mm) == (frozenset({(0, 0), (0, 1), (1, 0)}), (10.0, 0.0, 0.0))
        await nc.heartbeat(7)
        rows = ((0.02, 0.0, 0.0), *FLAT[1:])
        wanted = LinearOffsets((1.0, 0.0, 0.0), (rows[0], rows[1], rows[2]), (10.0, 0.0, 0.0))
        await slopes.write_linear(wanted)
        assert await slopes.read_linear() == wanted
        sent = next(message for message in agent.heard if message.get("do") == "write_slopes")
        assert (sent["owner"], sent["um"], sent["um_per_mm"]) == (7, [1.0, 0.0, 0.0], [list(row) for row in rows])


@pytest.mark.parametrize(
    ("k0", "slope", "reference", "says"),
    [
        (499.0, ((0.02, 0.0, 0.0), *FLAT[1:]), (10.0, 0.0, 0.0), "nc_offsets_beyond"),
        (0.0, ((1.0, -1.5, 0.0), *FLAT[1:]), (10.0, 0.0, 0.0), "nc_offsets_beyond"),
        (0.0, (*FLAT[:2], (0.0, 0.0, 0.1)), (10.0, 0.0, 0.0), "agent_no_slope axis=Z over=Z"),
        (0.0, ((float("nan"), 0.0, 0.0), *FLAT[1:]), (10.0, 0.0, 0.0), "slopes_not_finite"),
        (0.0, FLAT, (0.0, 0.0, 0.0), "agent_reference"),
    ],
)
async def test_slopes_that_the_agent_cannot_have_are_never_sent(
    k0: float, slope: Any, reference: Any, says: str, tmp_path: Path
) -> None:
    async with agent_and_driver(tmp_path) as (agent, nc):
        agent.answers[""] = {"version": 3, "capabilities": ["slopes"], "travel": TRAVEL}
        await nc.connect()
        assert nc.slopes is not None
        heard = len(agent.heard)
        with refusing(NotSendable, says):
            await nc.slopes.write_linear(LinearOffsets((k0, 0.0, 0.0), slope, reference))
        assert len(agent.heard) == heard


async def test_connected_again_to_an_agent_without_slopes_it_has_none(tmp_path: Path) -> None:
    async with agent_and_driver(tmp_path) as (agent, nc):
        agent.answers[""] = {"version": 3, "capabilities": ["slopes"], "travel": TRAVEL}
        await nc.connect()
        assert nc.slopes is not None
        await nc.close()
        agent.answers[""] = {"version": 3, "capabilities": ["shift"]}
        await nc.connect()
        assert nc.slopes is None


async def test_it_writes_as_the_owner_whose_heartbeat_this_agent_has_confirmed(tmp_path: Path) -> None:
    async with agent_and_driver(tmp_path) as (agent, nc):
        agent.answers["heartbeat"] = True

        async def owner_of_a_write() -> object:
            await nc.write_compensation((0.0, 0.0, 0.0))
            return next(message for message in reversed(agent.heard) if message.get("do") == "write")["owner"]

        agent.says.append(agent.signed(b'{"error": "belongs to gateway 8"}'))
        with pytest.raises(Refused, match="belongs to gateway 8"):
            await nc.heartbeat(7)
        assert await owner_of_a_write() == 0
        await nc.heartbeat(7)
        assert await owner_of_a_write() == 7
        await nc.close()
        await nc.connect()
        assert await owner_of_a_write() == 0, "another agent may have it now"
