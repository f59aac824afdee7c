"""Controls and buses of other packages: they are used like the gateway's own, and a broken one is reported in one
line."""

import asyncio
import json
import subprocess
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path

import pytest

from drivers.base import BadAnswer, ConnectError, Quality, Refused
from drivers.nc import WatchdogTerms
from gateway.acquisition.build import lines_of
from gateway.acquisition.once import read_once
from gateway.config.extended import stored_configuration
from gateway.config.file import parse
from gateway.config.model import GatewayConfig
from gateway.config.problems import ConfigError
from gateway.nc.build import control_of
from gateway.runtime.clocks import RealClock
from tests.benches.command import Done, here
from tests.benches.extension_package import example_wheel, files_of, install
from tests.benches.one_device import ONE_DEVICE
from tests.benches.refusals import refusing
from tests.benches.stream_server import stream_server

pytestmark = pytest.mark.usefixtures("no_package_stays_loaded")

BUS = """
[machine]
name = "mill"
[[bus]]
name = "board"
kind = "text_tcp"
host = "127.0.0.1"
port = 2000
[[device]]
name = "board1"
bus = "board"
profile = "numbers"
[device.channels]
bed = 0
column = 2
"""
NC = """
[[state]]
name = "spindle_speed"
[nc]
kind = "text_axes"
host = "127.0.0.1"
port = 5000
"""


def check(folder: Path, text: str) -> Done:
    file = folder / "gateway.toml"
    file.write_text(text, encoding="utf-8")
    return here("check", file)


def test_check_accepts_kinds_of_another_package_and_names_them(example: Path) -> None:
    done = check(example, BUS + NC)
    assert done.code == 0, done.together
    row = "kinds of other packages: [nc] kind 'text_axes' (talc-example 0.1.0), [[bus]] kind 'text_tcp' (talc-example"
    assert row in done.out
    assert "good." in done.out


@pytest.mark.slow
@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("port = 5000", "prot = 5000", "[nc] prot: unknown key; did you mean 'port'?"),
        ("port = 2000", "port = 0", "bus 'board', port: 0: expected at least 1"),
        ("port = 2000", "prot = 2000", "bus 'board', prot: unknown key; did you mean 'port'?"),
        ("port = 5000", "timeout_s = 9", "[nc]: timeout_s = 9: expected at most period_s = 1"),
        (
            "port = 5000",
            "port = 5000\n[probing]\narmed = true",
            "[probing] armed: true, but a control of kind 'text_axes'",
        ),
        (
            'profile = "numbers"',
            'profile = "icpdas_m7015"',
            "device 'board1': profile 'icpdas_m7015': expected 'numbers'",
        ),
        (
            'name = "spindle_speed"',
            'name = "door"',
            "state 'door': not every control provides it; possible: spindle_speed",
        ),
        ('kind = "text_axes"', 'kind = "text_axs"', "[nc] kind: unknown kind 'text_axs'; did you mean 'text_axes'?"),
        ('kind = "text_tcp"', 'kind = "text"', "bus 'board', kind: unknown kind 'text'; did you mean 'text_tcp'?"),
    ],
)
def test_a_mistake_in_its_section_is_reported_with_its_place(example: Path, old: str, new: str, says: str) -> None:
    done = check(example, (BUS + NC).replace(old, new))
    assert done.code == 2, done.together
    assert says in done.together
    assert "Traceback" not in done.together


def test_a_stored_configuration_is_read_again_and_has_the_same_fingerprint(example: Path) -> None:
    config = parse(BUS + NC, example / "gateway.toml")
    assert isinstance(config, GatewayConfig)
    assert json.loads(config.canonical())["nc"]["kind"] == "text_axes"
    assert stored_configuration(config.canonical()).fingerprint() == config.fingerprint()


BASES = "from typing import Literal\nfrom gateway.config.extensions import ControlSection, OtherBus\n"
ABSTRACT = BASES + 'class It(ControlSection):\n    kind: Literal["strange"]\n'
WHOLE = ABSTRACT + (
    "    @property\n    def address(self):\n        return ''\n    def known_states(self):\n        return ()\n"
    "    def control(self, poses_deg, states, clock):\n        raise RuntimeError('no licence')\n"
)
BROKEN = {
    "import error": (
        "import not_installed_anywhere\n",
        "ModuleNotFoundError: No module named 'not_installed_anywhere'",
    ),
    "syntax error": ("class It(:\n", "SyntaxError: invalid syntax"),
    "exit": ("raise SystemExit(7)\n", "SystemExit: 7"),
    "no such name": ("other = 1\n", "AttributeError: module 'other_package' has no attribute 'It'"),
    "no class": (
        "def It(): ...\n",
        "other_package:It is not a class derived from gateway.config.extensions.ControlSection",
    ),
    "another class": (
        BASES + "class It(OtherBus): ...\n",
        "other_package:It is not a class derived from gateway.config.extensions.ControlSection",
    ),
    "abstract": (ABSTRACT, "other_package:It does not define address, control, known_states"),
    "another kind": (
        WHOLE.replace('"strange"', '"odd"'),
        "other_package:It has kind ('odd',): expected Literal[\"strange\"]",
    ),
}


Offer = Callable[..., None]


@pytest.fixture
def offer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Offer:
    """Installs packages with a module of this code, each offering the kind `strange`; own: and a bus of this kind."""

    def offered(code: str, *packages: str, group: str = "controls", own: str = "") -> None:
        rows = {f"talc_gateway.{group}": {"strange": "other_package:It"}}
        if own:
            rows["talc_gateway.buses"] = {own: "other_package:It"}
        for name in packages or ("other",):
            install(files_of(name, rows, {"other_package.py": code}, "2.3"), tmp_path / "site")
        monkeypatch.syspath_prepend(str(tmp_path / "site"))

    return offered


STRANGE = '[nc]\nkind = "strange"\n'


@pytest.mark.parametrize(("code", "says"), BROKEN.values(), ids=BROKEN)
def test_a_broken_package_is_one_clear_line(code: str, says: str, tmp_path: Path, offer: Offer) -> None:
    offer(code)
    wanted, line = check(tmp_path, ONE_DEVICE + STRANGE), f"of the package other 2.3 cannot be used: {says}"
    assert wanted.code == 2
    assert f"gateway.toml: [nc], kind: kind 'strange' {line}" in wanted.together
    assert wanted.together.count("gateway.toml: ") == 1, "beside the line of the file"
    idle = check(tmp_path, ONE_DEVICE)
    assert idle.code == 0, "a package that is not used prevents nothing"
    assert f"warning: kind 'strange' {line}" in idle.err


SOUND = WHOLE.replace("raise RuntimeError('no licence')", "return None")
PLACELESS = BASES + (
    'class It(OtherBus):\n    kind: Literal["strange"]\n'
    "    @property\n    def place(self):\n        raise KeyError('X')\n"
    "    def bus(self, tap):\n        return None\n    def driver(self, device, bus, clock):\n        return None\n"
)


@pytest.mark.parametrize(
    ("group", "code", "section", "says"),
    [
        ("controls", WHOLE, STRANGE, "[nc]: the package of kind 'strange' failed: RuntimeError: no licence"),
        ("controls", SOUND.replace("return ()", "raise KeyError('X')"), STRANGE, "[nc]: the package of kind 'strange'"),
        ("buses", PLACELESS, '[[bus]]\nname = "odd"\nkind = "strange"\n', "bus 'odd': the package of kind 'strange'"),
    ],
)
def test_a_bug_of_the_package_is_reported_at_its_place(
    group: str, code: str, section: str, says: str, tmp_path: Path, offer: Offer
) -> None:
    offer(code, group=group)
    done = check(tmp_path, ONE_DEVICE + section)
    assert done.code == 2, done.together
    assert says in done.together
    assert "failed: RuntimeError: no licence" in done.together or "failed: KeyError: 'X'" in done.together


def test_states_may_come_from_a_generator(tmp_path: Path, offer: Offer) -> None:
    offer(SOUND.replace("return ()", "yield from ('door', 'lamp')"))
    states = "".join(f'[[state]]\nname = "{name}"\n' for name in ("lamp", "door"))
    done = check(tmp_path, ONE_DEVICE + states + STRANGE)
    assert done.code == 0, done.together


def test_two_packages_of_one_kind_and_a_kind_of_the_gateway_s_own(tmp_path: Path, offer: Offer) -> None:
    offer(WHOLE, "first", "second", own="modbus_tcp")
    done = check(tmp_path, ONE_DEVICE + STRANGE)
    assert done.code == 2
    assert "kind 'strange' is offered by " in done.together
    own = check(tmp_path, ONE_DEVICE)
    assert own.code == 0
    assert "kind 'modbus_tcp' of the package" in own.err
    assert "is not used: the gateway has that kind itself" in own.err


@asynccontextmanager
async def answering(answer: Callable[[bytes], bytes]) -> AsyncIterator[int]:
    """A server that answers each line; its port."""

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(ConnectionError):
            while line := await reader.readline():
                if said := answer(line):
                    writer.write(said)
                    await writer.drain()
        writer.close()

    async with stream_server(serve) as port:
        yield port


async def test_its_bus_is_read_as_any_other(example: Path) -> None:
    async with answering(lambda _: b"21.5 7 nan\n") as port:
        config = parse(BUS.replace("2000", str(port)), example / "gateway.toml")
        (line,) = lines_of(config, RealClock())
        (answer,) = await read_once(line, RealClock())
        await line.bus.close()
    assert [(r.channel, r.quality) for r in answer.readings] == [
        ("bed", Quality.GOOD),
        ("column", Quality.SENSOR_FAULT),
    ]
    assert answer.readings[0].value == 21.5


async def test_its_control_is_read_and_never_written_to(example: Path) -> None:
    async with answering(lambda _: b"100.5 -20 30 10 720 6000\n") as port:
        config = parse(BUS + NC.replace("5000", str(port)), example / "gateway.toml")
        assert config.nc is not None
        nc = control_of(config.nc, config, RealClock())
        await nc.connect()
        snapshot = await nc.snapshot()
        await nc.close()
    assert snapshot.positions == {"X": 100.5, "Y": -20.0, "Z": 30.0, "A": 10.0, "C": 720.0}
    assert snapshot.states == {"spindle_speed": 6000.0}
    assert snapshot.cannot_probe == "the control is only read"
    with refusing(Refused, "nc_only_read mode_works"):
        await nc.claim(7, WatchdogTerms(10.0, 1.0))
    with pytest.raises(ConnectError, match="connect first"):
        await nc.snapshot()


@pytest.mark.parametrize("line", [b"1 2 3 4 5\n", b"1 2 3 4 nan 6\n", b"X\n"])
async def test_what_its_control_must_not_answer_is_a_driver_s_error(line: bytes, example: Path) -> None:
    async with answering(lambda _: line) as port:
        config = parse(BUS + NC.replace("5000", str(port)), example / "gateway.toml")
        assert config.nc is not None
        nc = control_of(config.nc, config, RealClock())
        with pytest.raises(BadAnswer):
            await nc.connect()
        await nc.close()


@pytest.mark.slow
def test_the_example_installed_by_pip_is_found_by_the_program(tmp_path: Path) -> None:
    site = tmp_path / "site"
    wheel = example_wheel(tmp_path)
    options = ["--quiet", "--no-index", "--no-deps", "--target", str(site)]
    subprocess.run([sys.executable, "-m", "pip", "install", *options, str(wheel)], check=True)
    file = tmp_path / "gateway.toml"
    file.write_text(BUS + NC, encoding="utf-8")
    command = [sys.executable, "-m", "gateway", "check", str(file)]
    without = subprocess.run(command, capture_output=True, text=True, check=False)
    assert without.returncode == 2
    assert "unknown kind 'text_axes'" in without.stderr
    done = subprocess.run(command, capture_output=True, text=True, check=False, env={"PYTHONPATH": str(site)})
    assert done.returncode == 0, done.stderr
    assert "(talc-example 0.1.0)" in done.stdout


def test_without_such_kinds_no_package_is_looked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def never(**_: object) -> None:
        raise AssertionError("looked for")

    monkeypatch.setattr("gateway.config.extensions.entry_points", never)
    assert parse(ONE_DEVICE, tmp_path / "gateway.toml").machine.name == "mill"
    with pytest.raises(ConfigError, match="unknown key"):
        parse(ONE_DEVICE + "[nothing]\n", tmp_path / "gateway.toml")
