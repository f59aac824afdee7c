"""Finds the devices on a wire, to write a configuration. It only reads."""

from gateway.scan.can import CanScan, scan_can
from gateway.scan.found import Found, Place, Progress, ScanReport
from gateway.scan.fragment import check, merged
from gateway.scan.ports import ScanPort, find_ports
from gateway.scan.serial import LineTry, SerialScan, plan, scan_line
from gateway.scan.tcp import TcpScan, scan_hosts

__all__ = [
    "CanScan",
    "Found",
    "LineTry",
    "Place",
    "Progress",
    "ScanPort",
    "ScanReport",
    "SerialScan",
    "TcpScan",
    "check",
    "find_ports",
    "merged",
    "plan",
    "scan_can",
    "scan_hosts",
    "scan_line",
]
