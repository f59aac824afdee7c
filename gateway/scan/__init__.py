"""Finds the devices on a wire, to write a configuration. It only reads."""

from gateway.scan.can import CanScan, scan_can
from gateway.scan.found import Found, Place, Progress, Report, Stopped
from gateway.scan.fragment import check, merged
from gateway.scan.ports import Port, find_ports
from gateway.scan.serial import LineTry, SerialScan, plan, scan_line
from gateway.scan.tcp import TcpScan, scan_hosts

__all__ = [
    "CanScan",
    "Found",
    "LineTry",
    "Place",
    "Port",
    "Progress",
    "Report",
    "SerialScan",
    "Stopped",
    "TcpScan",
    "check",
    "find_ports",
    "merged",
    "plan",
    "scan_can",
    "scan_hosts",
    "scan_line",
]
