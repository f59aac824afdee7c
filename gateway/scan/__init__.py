"""Finds the devices on a wire, or looks into one, to write a configuration. It only reads."""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from gateway.scan.can import CanScan, scan_can
    from gateway.scan.drafts import node_draft, object_draft
    from gateway.scan.first import (
        Answers,
        ControlAnswers,
        LinuxCncAnswers,
        MtConnectAnswers,
        SinumerikAnswers,
        first_configuration,
        read_answers,
        to_confirm,
    )
    from gateway.scan.found import Found, Place, ScanProgress, ScanReport, open_bus
    from gateway.scan.fragment import check_addable, merged
    from gateway.scan.ports import ScanPort, find_ports
    from gateway.scan.registers import ORDERS, Meaning, SeenWords, profile_draft, read_words
    from gateway.scan.serial import plan, scan_line, scanned_port
    from gateway.scan.tcp import TcpScan, scan_hosts, scanned_host
    from gateway.scan.topics import SeenTopic, bus_period_s, seen_topics, topic_draft
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".can": ("CanScan", "scan_can"),
            ".drafts": ("node_draft", "object_draft"),
            ".first": (
                "Answers",
                "ControlAnswers",
                "LinuxCncAnswers",
                "MtConnectAnswers",
                "SinumerikAnswers",
                "first_configuration",
                "read_answers",
                "to_confirm",
            ),
            ".found": ("Found", "Place", "ScanProgress", "ScanReport", "open_bus"),
            ".fragment": ("check_addable", "merged"),
            ".ports": ("ScanPort", "find_ports"),
            ".registers": ("ORDERS", "Meaning", "SeenWords", "profile_draft", "read_words"),
            ".serial": ("plan", "scan_line", "scanned_port"),
            ".tcp": ("TcpScan", "scan_hosts", "scanned_host"),
            ".topics": ("SeenTopic", "bus_period_s", "seen_topics", "topic_draft"),
        },
    )

__all__ = [
    "ORDERS",
    "Answers",
    "CanScan",
    "ControlAnswers",
    "Found",
    "LinuxCncAnswers",
    "Meaning",
    "MtConnectAnswers",
    "Place",
    "ScanPort",
    "ScanProgress",
    "ScanReport",
    "SeenTopic",
    "SeenWords",
    "SinumerikAnswers",
    "TcpScan",
    "bus_period_s",
    "check_addable",
    "find_ports",
    "first_configuration",
    "merged",
    "node_draft",
    "object_draft",
    "open_bus",
    "plan",
    "profile_draft",
    "read_answers",
    "read_words",
    "scan_can",
    "scan_hosts",
    "scan_line",
    "scanned_host",
    "scanned_port",
    "seen_topics",
    "to_confirm",
    "topic_draft",
]
