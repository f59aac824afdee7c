"""Which ports a computer has, from folders as the kernel and udev make them."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from gateway.cli.main import main
from gateway.commissioning.scan.ports import ScanPort, find_ports


@pytest.fixture
def computer(tmp_path: Path) -> tuple[Path, Path]:
    dev, net = tmp_path / "dev", tmp_path / "net"
    by_id = dev / "serial" / "by-id"
    by_id.mkdir(parents=True)
    for name in ("ttyUSB0", "ttyUSB1", "ttyS0"):
        (dev / name).touch()
    (by_id / "usb-FTDI_RS485-if00").symlink_to("../../ttyUSB1")
    for name, kind, state in (("can0", "280", "up"), ("eth0", "1", "up"), ("can1", "280", "down")):
        (net / name).mkdir(parents=True)
        (net / name / "type").write_text(kind + "\n")
        (net / name / "operstate").write_text(state + "\n")
    return dev, net


def test_lasting_names_come_first_and_each_adapter_once(computer: tuple[Path, Path]) -> None:
    dev, net = computer
    assert find_ports(dev, net) == [
        ScanPort("serial", str(dev / "serial/by-id/usb-FTDI_RS485-if00"), "ttyUSB1"),
        ScanPort("serial", str(dev / "ttyUSB0"), "may have another name after a reboot"),
        ScanPort("can", "can0", "up"),
        ScanPort("can", "can1", "down"),
    ]


def test_computer_without_any_has_none(tmp_path: Path) -> None:
    assert find_ports(tmp_path / "dev", tmp_path / "net") == []


def test_the_command_lists_this_computer_s_ports_as_arguments_for_scan() -> None:
    found = find_ports()
    answer = CliRunner().invoke(main, ["scan", "ports"], catch_exceptions=False)
    lines = answer.output.splitlines()
    assert lines == [f"scan {port.command} {port.name}    ({port.remark})" for port in found] or not found
    assert (answer.exit_code == 0) == bool(found)
    if not found:
        assert "no serial adapter and no CAN interface" in answer.output
