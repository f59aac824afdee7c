"""Finds the devices on a wire, to write a configuration. It only reads."""

from gateway.scan.can import CanScan, scan_can
from gateway.scan.first import Answers, LinuxCncAnswers, SinumerikAnswers, first_configuration, read_answers, to_confirm
from gateway.scan.found import Found, Place, Progress, ScanReport
from gateway.scan.fragment import check, merged
from gateway.scan.ports import ScanPort, find_ports
from gateway.scan.serial import LineTry, SerialScan, plan, scan_line
from gateway.scan.tcp import TcpScan, scan_hosts

__all__ = [
    "Answers",
    "CanScan",
    "Found",
    "LineTry",
    "LinuxCncAnswers",
    "Place",
    "Progress",
    "ScanPort",
    "ScanReport",
    "SerialScan",
    "SinumerikAnswers",
    "TcpScan",
    "check",
    "find_ports",
    "first_configuration",
    "merged",
    "plan",
    "read_answers",
    "scan_can",
    "scan_hosts",
    "scan_line",
    "to_confirm",
]
