"""`[nc]` of kind `mtconnect`: what the driver gets from the file, and what `check` and `probe` say about it."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from gateway.cli.main import main
from gateway.config.consequences import unarmed
from gateway.config.controls import MtConnectNc
from gateway.config.file import parse
from gateway.config.problems import ConfigError
from gateway.nc.build import control_of
from gateway.runtime.clocks import RealClock
from tests.benches.mtconnect_agent import mtconnect_agent
from tests.benches.service_file import MACHINE, adam6015

pytestmark = pytest.mark.filterwarnings("ignore:datetime:DeprecationWarning")
TEXT = (
    MACHINE
    + adam6015("ambient = 0", "127.0.0.1", "port = 9")
    + """
[[state]]
name = "spindle_speed"
[nc]
kind = "mtconnect"
url = "http://127.0.0.1:5000"
mode = "mode"
[nc.positions]
X = "Xpos"
Y = "Ypos"
Z = "Zpos"
A = "Apos"
C = "Cpos"
[nc.states]
spindle_speed = "Srpm"
speed_X = "Xfrt"
"""
)


def test_the_driver_gets_the_states_that_models_use() -> None:
    config = parse(TEXT, Path("gateway.toml"))
    assert isinstance(config.nc, MtConnectNc)
    settings = config.nc.settings(config.probing.poses_deg, ["spindle_speed"])
    assert settings.states == {"spindle_speed": "Srpm"}
    assert (settings.positions["C"], settings.mode, settings.timeout_s) == ("Cpos", "mode", 2.0)
    assert unarmed(config)[0] == (
        "nothing will be learnt and nothing corrected: a control of kind 'mtconnect' is only read"
    )


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('url = "http:', 'url = "https:', "[nc] url: 'https://127.0.0.1:5000': expected http://HOST:PORT"),
        ('C = "Cpos"\n', "", "[nc.positions]: X, Y, Z, A: expected the id of a data item for each of X, Y, Z, A, C"),
        ('name = "spindle_speed"', 'name = "door"', "or name its data item: [nc.states] door = "),
        ("[nc.states]", "[probing]\narmed = true\n[nc.states]", "[probing] armed: true, but a control of kind 'mtconn"),
        (
            "[nc.states]",
            '[compensation]\nmode = "compensate"\n[nc.states]',
            "[compensation] mode: 'compensate', but a control of kind 'mtconnect' is only read; use 'monitor'",
        ),
    ],
)
def test_settings_that_cannot_work_are_reported_with_their_place(old: str, new: str, says: str) -> None:
    with pytest.raises(ConfigError) as refused:
        parse(TEXT.replace(old, new), Path("gateway.toml"))
    assert says in str(refused.value)


async def test_the_configured_control_is_read(tmp_path: Path) -> None:
    with mtconnect_agent(tmp_path) as (agent, url):
        for item in ("Xpos", "Ypos", "Zpos", "Apos", "Cpos", "Srpm"):
            agent.push_data(item, 12.5)
        config = parse(TEXT.replace("http://127.0.0.1:5000", url), Path("gateway.toml"))
        assert config.nc is not None
        nc = control_of(config.nc, config, RealClock())
        await nc.connect()
        assert (await nc.snapshot()).states == {"spindle_speed": 12.5}
        await nc.close()


def test_probe_shows_the_control_beside_a_device_that_is_silent(tmp_path: Path) -> None:
    with mtconnect_agent(tmp_path) as (agent, url):
        for item in ("Xpos", "Ypos", "Zpos", "Apos", "Cpos", "Srpm"):
            agent.push_data(item, 12.5)
        file = tmp_path / "gateway.toml"
        file.write_text(TEXT.replace("http://127.0.0.1:5000", url))
        done = CliRunner().invoke(main, ["probe", str(file)])
    assert "position C" in done.output
    assert "12.500" in done.output
    assert "8 of 9 good" in done.output
