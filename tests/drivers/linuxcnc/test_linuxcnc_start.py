"""How the agent of deploy/nc/linuxcnc starts: where it listens, and which keys it takes.

In part in the real LinuxCNC, Debian's linuxcnc-uspace.
"""

import json
from pathlib import Path
from typing import Any

import pytest

from simulators.linuxcnc.machine import machine
from tests.benches.linuxcnc_module import linuxcnc_module

KEY = "0123456789abcdef0123456789abcdef"
LOOPBACK = "0100007F"
"""127.0.0.1 as the kernel writes it on a computer of our kind."""
PORT = 7621


@pytest.fixture
def talc_server() -> Any:
    """The agent's server module, which needs nothing of LinuxCNC."""
    return linuxcnc_module("talc_server")


@pytest.mark.peer
@pytest.mark.parametrize(
    ("settings", "port"),
    [
        pytest.param({}, PORT, id="as shipped"),
        pytest.param({"ADDRESS": "", "PORT": ""}, PORT, id="nothing said"),
        pytest.param({"PORT": 7700}, 7700, id="another port"),
    ],
)
async def test_it_listens_on_the_loopback_alone(settings: dict[str, object], port: int, tmp_path: Path) -> None:
    async with machine(tmp_path, key=KEY, settings=settings) as operator:
        assert await operator.ask("listening", port) == [LOOPBACK]
        assert len(json.loads(await operator.ask("greeting", port))["challenge"]) == 64


@pytest.mark.peer
async def test_linuxcnc_does_not_start_with_a_key_that_is_too_short(tmp_path: Path) -> None:
    with pytest.raises(ConnectionError, match=r"talc\.key: the key has 31 characters: expected at least 32"):
        async with machine(tmp_path, key=KEY[:31]):
            pass


def test_a_key_is_read_only_where_nobody_else_may_read_it(talc_server: Any, tmp_path: Path) -> None:
    path = tmp_path / "talc.key"
    with pytest.raises(SystemExit, match=r"no such file; make one: .*openssl rand -hex 32"):
        talc_server.read_key(path)
    path.write_text(f" {KEY}\n")
    for mode in (0o640, 0o604, 0o620, 0o602, 0o601, 0o610, 0o644):
        path.chmod(mode)
        with pytest.raises(SystemExit, match="others may read the key: chmod 600"):
            talc_server.read_key(path)
    for mode in (0o600, 0o400):
        path.chmod(mode)
        assert talc_server.read_key(path) == KEY.encode()


def test_a_key_is_long_enough_without_the_white_space_around_it(talc_server: Any, tmp_path: Path) -> None:
    path = tmp_path / "talc.key"
    path.touch(0o600)
    for text in ("", "\n" * 40, f"  {KEY[:31]}\n"):
        path.write_text(text)
        with pytest.raises(SystemExit, match=f"has {len(text.strip())} characters: expected at least 32"):
            talc_server.read_key(path)
