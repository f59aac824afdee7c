"""The unit file: what systemd itself says about it, and that it fits the program and the package."""

import re
import shlex
import subprocess
from configparser import ConfigParser
from pathlib import Path
from shutil import which

import click
import pytest

from gateway.cli.exits import EXIT_CONFIG
from gateway.cli.main import main

UNIT = Path(__file__).parents[1] / "deploy" / "systemd" / "talc-gateway.service"


def unit() -> ConfigParser:
    parser = ConfigParser(strict=False, interpolation=None, delimiters=("=",))
    parser.optionxform = str  # type: ignore[assignment, method-assign]
    parser.read(UNIT)
    return parser


def test_a_configuration_that_is_invalid_is_not_tried_again_and_anything_else_without_end() -> None:
    service = unit()["Service"]
    assert service["RestartPreventExitStatus"] == str(EXIT_CONFIG)
    assert service["Restart"] == "on-failure"
    assert int(service["RestartSec"]) >= 10
    assert unit()["Unit"]["StartLimitIntervalSec"] == "0"


def test_a_training_that_takes_all_memory_ends_alone() -> None:
    assert unit()["Service"]["MemoryMax"] == "1G"
    assert unit()["Service"]["OOMPolicy"] == "continue", "systemd's own policy stops all of the service"


def test_the_service_may_divide_its_own_control_group_and_no_other() -> None:
    service = unit()["Service"]
    assert service["Delegate"] == "cpu"
    assert service["ProtectControlGroups"] == "yes"
    assert service["ReadWritePaths"] == f"-/sys/fs/cgroup/system.slice/{UNIT.name}"


def test_a_reload_needs_no_program_that_a_minimal_debian_has_not() -> None:
    assert unit()["Service"]["ExecReload"] == "/bin/sh -c 'kill -HUP $MAINPID'"


def test_serial_adapters_are_allowed_also_those_plugged_in_later() -> None:
    """systemd omits a kind of device that the kernel does not know when the service starts."""
    lines = UNIT.read_text("utf-8").splitlines()
    allowed = {line.removeprefix("DeviceAllow=") for line in lines if line.startswith("DeviceAllow=")}
    assert allowed == {f"char-{kind} rw" for kind in ("ttyUSB", "ttyACM", "ttyAMA", "ttyS")}
    for kind in ("Wants", "After"):
        assert f"{kind}=modprobe@usbserial.service modprobe@cdc_acm.service" in lines


@pytest.mark.peer
@pytest.mark.parametrize("unit", sorted(UNIT.parent.glob("*.service")), ids=lambda unit: unit.stem)
def test_systemd_finds_it_hardened_and_without_mistakes(unit: Path) -> None:
    """Read by systemd-analyze; nothing is started."""
    assert which("systemd-analyze"), "Debian's package systemd"
    done = subprocess.run(
        ["systemd-analyze", "security", "--offline=true", "--threshold=20", "--no-pager", str(unit)],
        capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Overall exposure level" in done.stdout
    verified = subprocess.run(["systemd-analyze", "verify", str(unit)], capture_output=True, text=True)
    faults = [line for line in verified.stderr.splitlines() if unit.name in line and "is not executable" not in line]
    assert faults == []


@pytest.mark.parametrize("unit", sorted(UNIT.parent.glob("talc-gateway-*.service")), ids=lambda unit: unit.stem)
def test_each_unit_beside_it_starts_a_command_as_the_program_has_it(unit: Path) -> None:
    """With the options of the unit's own example."""
    text = unit.read_text(encoding="utf-8")
    (line,) = re.findall(r"^ExecStart=\S+/talc-gateway (.*)$", text, re.MULTILINE)
    example = re.findall(r'OPTIONS="(.*)"$', text, re.MULTILINE)
    words = shlex.split(line.replace("$OPTIONS", example[0].removesuffix(" --authority ...") if example else ""))
    command = main.get_command(click.Context(main), words[0])
    assert command is not None
    parser = command.make_parser(click.Context(command))
    given, left, _ = parser.parse_args(words[1:])
    assert left == []
    assert [name for name, value in given.items() if value is not None]
