"""The unit file: what systemd itself says about it, and that it fits the program and the package."""

import subprocess
from configparser import ConfigParser
from pathlib import Path
from shutil import which

import pytest

from gateway.cli.exits import EXIT_CONFIG

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
def test_systemd_finds_it_hardened_and_without_mistakes() -> None:
    """Read by systemd-analyze; nothing is started."""
    assert which("systemd-analyze"), "Debian's package systemd"
    done = subprocess.run(
        ["systemd-analyze", "security", "--offline=true", "--threshold=20", "--no-pager", str(UNIT)],
        capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Overall exposure level" in done.stdout
    verified = subprocess.run(["systemd-analyze", "verify", str(UNIT)], capture_output=True, text=True)
    faults = [line for line in verified.stderr.splitlines() if UNIT.name in line and "is not executable" not in line]
    assert faults == []
