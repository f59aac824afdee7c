"""The driver that a configuration gets: it requires of the control what this gateway will use, and no more."""

from pathlib import Path

import pytest

from drivers.base import WrongDevice
from gateway.config.controls import SinumerikNc
from gateway.config.file import parse
from gateway.nc.build import control_of
from gateway.runtime.clocks import RealClock
from simulators.nc import Activity, DayPart, EmulatedControl, LoadCase, MeanLoads
from tests.benches.emulated_bench import Rigid
from tests.benches.one_device import ONE_DEVICE
from tests.benches.reference_agent import POSES_DEG, REFERENCE, served_agent
from tests.benches.refusals import refusing

pytestmark = pytest.mark.simulated_time

TEXT = (
    ONE_DEVICE
    + """[nc]
kind = "sinumerik"
url = "{url}"
security = "none"
[nc.handshake]
withdraw = 201
[nc.lease]
owner = 202
[probing]
armed = {armed}
[compensation]
mode = "{mode}"
"""
)


@pytest.mark.parametrize(
    ("mode", "armed", "missing"),
    [
        ("monitor", False, None),
        ("advise", False, None),
        ("monitor", True, 201),
        ("advise", True, 201),
        ("compensate", False, 202),
    ],
)
async def test_a_gateway_that_only_reads_needs_no_parameter_of_claim_and_request(
    mode: str, armed: bool, missing: int | None
) -> None:
    day = LoadCase([DayPart(0.0, 1e9, Activity.ROUGHING, MeanLoads())])
    control = EmulatedControl(Rigid(), RealClock(), day)
    try:
        text = TEXT.format(url=await control.start(), mode=mode, armed=str(armed).lower())
        config = parse(text, Path("/srv/talc/gateway.toml"))
        assert config.nc is not None
        nc = control_of(config.nc, config, RealClock())
        if missing is None:
            await nc.connect()
            assert set((await nc.snapshot()).positions) == set("XYZAC")
            await nc.close()
        else:
            with pytest.raises(WrongDevice, match=rf"R\[u1,{missing}\] does not exist"):
                await nc.connect()
    finally:
        await control.stop()


@pytest.mark.parametrize(("writes", "session_s"), [(True, 5.0), (False, 60.0)])
def test_a_session_that_writes_ends_long_before_the_control_s_watchdog(writes: bool, session_s: float) -> None:
    """No write that the network holds up acts after the control has begun to ramp."""
    config = parse(TEXT.format(url="opc.tcp://nc:4840", mode="compensate", armed="true"), Path("gateway.toml"))
    assert isinstance(config.nc, SinumerikNc)
    made = config.nc.settings(config.probing.poses_deg, (), writes=writes, watchdog_s=10.0)
    assert made.session_s == session_s


@pytest.mark.parametrize("kind", ["agent", "linuxcnc"])
async def test_a_control_whose_agent_states_other_poses_than_the_configuration_is_refused(
    kind: str, tmp_path: Path
) -> None:
    async with served_agent(REFERENCE.Machine()) as served:
        agent = served.settings(tmp_path)
        poses = [list(pose) for pose in (*POSES_DEG[:4], *POSES_DEG[:3:-1])]
        text = f'{ONE_DEVICE}[nc]\nkind = "{kind}"\nport = {agent.port}\nkey_file = "{agent.key_file}"\n[probing]\n'
        config = parse(f"{text}poses_deg = {poses}", Path("/srv/talc/gateway.toml"))
        assert config.nc is not None
        with refusing(WrongDevice, "agent_pose i=5 found=A_90_C_0 other=A_-90_C_0 agent_poses_hint"):
            await control_of(config.nc, config, RealClock()).connect()
