"""Typed configuration of one gateway: one TOML file in, one frozen value out, clear messages when it is invalid."""

from gateway.config.buses import (
    BusSection,
    CanOpenSection,
    CanSection,
    MeEthernetSection,
    ModbusRtuSection,
    ModbusRtuTcpSection,
    ModbusTcpSection,
)
from gateway.config.consequences import unarmed
from gateway.config.controls import LinuxCncNc, Nc, SinumerikNc
from gateway.config.fields import Name
from gateway.config.file import draft, load, parse, read, read_as
from gateway.config.metrics import Metrics
from gateway.config.model import Channel, GatewayConfig, validate
from gateway.config.packed import packed_toml, unpacked
from gateway.config.prior import PriorError, PriorFile, described, parse_prior, prior_for
from gateway.config.problems import ConfigError, Problem, place, shown, suggestion
from gateway.config.rules import cautions
from gateway.config.sections import Compensation, Probing, Storage
from gateway.config.talc_only import TalcOnly, load_talc_only
from gateway.config.telemetry import EndpointParts, Telemetry, TelemetryTls, endpoint
from gateway.config.telemetry_rules import credential_problems
from gateway.config.wires import toml_value, wires_toml

__all__ = [
    "BusSection",
    "CanOpenSection",
    "CanSection",
    "Channel",
    "Compensation",
    "ConfigError",
    "EndpointParts",
    "GatewayConfig",
    "LinuxCncNc",
    "MeEthernetSection",
    "Metrics",
    "ModbusRtuSection",
    "ModbusRtuTcpSection",
    "ModbusTcpSection",
    "Name",
    "Nc",
    "PriorError",
    "PriorFile",
    "Probing",
    "Problem",
    "SinumerikNc",
    "Storage",
    "TalcOnly",
    "Telemetry",
    "TelemetryTls",
    "cautions",
    "credential_problems",
    "described",
    "draft",
    "endpoint",
    "load",
    "load_talc_only",
    "packed_toml",
    "parse",
    "parse_prior",
    "place",
    "prior_for",
    "read",
    "read_as",
    "shown",
    "suggestion",
    "toml_value",
    "unarmed",
    "unpacked",
    "validate",
    "wires_toml",
]
