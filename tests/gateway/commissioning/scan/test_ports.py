"""Which ports a computer has, from folders as the kernel and udev make them."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from gateway.cli.main import main
from gateway.commissioning.scan.ports import ScanPort, find_ports


@pytest.fixture
def computer(tmp_path: Path) -> tuple[Path, Path]:
    dev, net = tmp_path / "dev", tmp_path / "sys/class/net"
    by_id = dev / "serial" / "by-id"
    by_id.mkdir(parents=True)
    for name in ("ttyUSB0", "ttyUSB1", "ttyS0"):
        (dev / name).touch()
    (by_id / "usb-FTDI_RS485-if00").symlink_to("../../ttyUSB1")
    for name, kind, state in (("can0", "280", "up"), ("eth0", "1", "up"), ("can1", "280", "down")):
        (net / name).mkdir(parents=True)
        (net / name / "type").write_text(kind + "\n")
        (net / name / "operstate").write_text(state + "\n")
    return dev, tmp_path / "sys"


def test_lasting_names_come_first_and_each_adapter_once(computer: tuple[Path, Path]) -> None:
    dev, sys = computer
    assert find_ports(dev, sys) == [
        ScanPort("serial", str(dev / "serial/by-id/usb-FTDI_RS485-if00"), "ttyUSB1"),
        ScanPort("serial", str(dev / "ttyUSB0"), "may have another name after a reboot"),
        ScanPort("can", "can0", "up"),
        ScanPort("can", "can1", "down"),
    ]


def test_adapters_without_a_serial_number_are_named_by_their_sockets(computer: tuple[Path, Path]) -> None:
    """Two CH340: udev's by-id name is that of the one that was plugged in last."""
    dev, sys = computer
    ch340s(dev, sys, "ttyUSB0", "ttyUSB2")
    assert find_ports(dev, sys)[:3] == [
        ScanPort("serial", str(dev / "serial/by-id/usb-FTDI_RS485-if00"), "ttyUSB1"),
        ScanPort("serial", str(dev / "serial/by-path/pci-usb-0:ttyUSB0-port0"), "ttyUSB0, in this socket"),
        ScanPort("serial", str(dev / "serial/by-path/pci-usb-0:ttyUSB2-port0"), "ttyUSB2, in this socket"),
    ]


def ch340s(dev: Path, sys: Path, *names: str) -> None:
    by_path = dev / "serial" / "by-path"
    by_path.mkdir(parents=True)
    for name in names:
        (dev / name).touch()
        (by_path / f"pci-usb-0:{name}-port0").symlink_to(f"../../{name}")
        usb = sys / "devices" / f"of {name}"
        (usb / "interface").mkdir(parents=True)
        (usb / "idVendor").write_text("1a86\n")
        (usb / "idProduct").write_text("7523\n")
        (sys / "class/tty" / name).mkdir(parents=True)
        (sys / "class/tty" / name / "device").symlink_to(usb / "interface")
    (dev / "serial/by-id/usb-1a86_USB_Serial-if00-port0").symlink_to(f"../../{names[-1]}")


def test_computer_without_any_has_none(tmp_path: Path) -> None:
    assert find_ports(tmp_path / "dev", tmp_path / "sys") == []


def test_the_command_lists_this_computer_s_ports_as_arguments_for_scan() -> None:
    found = find_ports()
    answer = CliRunner().invoke(main, ["scan", "ports"], catch_exceptions=False)
    lines = answer.output.splitlines()
    assert lines == [f"scan {port.command} {port.name}    ({port.remark})" for port in found] or not found
    assert (answer.exit_code == 0) == bool(found)
    if not found:
        assert "no serial adapter and no CAN interface" in answer.output
