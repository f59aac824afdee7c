"""Typed configuration of one gateway: one TOML file in, one frozen value out, clear messages when it is invalid."""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from gateway.config.certificates import certificate_end, certificate_ends
    from gateway.config.consequences import unarmed
    from gateway.config.controls import AgentNc, LinuxCncNc, MtConnectNc, Nc, SinumerikNc
    from gateway.config.extended import other_kinds, stored_configuration, validate
    from gateway.config.extensions import OUTLETS, ControlSection, OtherBus, asked, sections_of_others
    from gateway.config.fields import DEFAULT_PREFIX, LOOPBACK, NAME_FORM, KeyPrefix, Name, key_prefix, machine_name
    from gateway.config.file import draft, load, parse
    from gateway.config.metrics import Metrics
    from gateway.config.model import GatewayConfig
    from gateway.config.outline import inputs_if_known, inputs_of_config, outlined, step_s_of
    from gateway.config.packed import packed_toml, unpacked
    from gateway.config.polled import PERIOD_S, READ_LIMIT_S, RETRY_MAX_PERIODS, BusSection
    from gateway.config.prior import PriorError, PriorFile, described, parse_prior, prior_for
    from gateway.config.problems import ConfigError, Problem, place, read_sections, shown, suggestion
    from gateway.config.reading import any_section_of, data_of, kinds_in, read_as, read_text
    from gateway.config.rules import cautions
    from gateway.config.sections import Compensation, Device, Limits, Probing, Storage
    from gateway.config.talc_only import TalcOnly, load_talc_only
    from gateway.config.telemetry import Endpoint, Operator, Telemetry, TelemetryTls, endpoint
    from gateway.config.telemetry_rules import credential_problems
    from gateway.config.wires import toml_value, wires_toml
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".certificates": ("certificate_end", "certificate_ends"),
            ".consequences": ("unarmed",),
            ".controls": ("AgentNc", "LinuxCncNc", "MtConnectNc", "Nc", "SinumerikNc"),
            ".extended": ("other_kinds", "stored_configuration", "validate"),
            ".extensions": ("OUTLETS", "ControlSection", "OtherBus", "asked", "sections_of_others"),
            ".fields": ("DEFAULT_PREFIX", "LOOPBACK", "NAME_FORM", "KeyPrefix", "Name", "key_prefix", "machine_name"),
            ".file": ("draft", "load", "parse"),
            ".metrics": ("Metrics",),
            ".model": ("GatewayConfig",),
            ".outline": ("inputs_if_known", "inputs_of_config", "outlined", "step_s_of"),
            ".packed": ("packed_toml", "unpacked"),
            ".polled": ("PERIOD_S", "READ_LIMIT_S", "RETRY_MAX_PERIODS", "BusSection"),
            ".prior": ("PriorError", "PriorFile", "described", "parse_prior", "prior_for"),
            ".problems": ("ConfigError", "Problem", "place", "read_sections", "shown", "suggestion"),
            ".reading": ("data_of", "kinds_in", "any_section_of", "read_as", "read_text"),
            ".rules": ("cautions",),
            ".sections": ("Compensation", "Device", "Limits", "Probing", "Storage"),
            ".talc_only": ("TalcOnly", "load_talc_only"),
            ".telemetry": ("Endpoint", "Operator", "Telemetry", "TelemetryTls", "endpoint"),
            ".telemetry_rules": ("credential_problems",),
            ".wires": ("toml_value", "wires_toml"),
        },
    )

__all__ = [
    "DEFAULT_PREFIX",
    "LOOPBACK",
    "NAME_FORM",
    "OUTLETS",
    "PERIOD_S",
    "READ_LIMIT_S",
    "RETRY_MAX_PERIODS",
    "AgentNc",
    "BusSection",
    "Compensation",
    "ConfigError",
    "ControlSection",
    "Device",
    "Endpoint",
    "GatewayConfig",
    "KeyPrefix",
    "Limits",
    "LinuxCncNc",
    "Metrics",
    "MtConnectNc",
    "Name",
    "Nc",
    "Operator",
    "OtherBus",
    "PriorError",
    "PriorFile",
    "Probing",
    "Problem",
    "SinumerikNc",
    "Storage",
    "TalcOnly",
    "Telemetry",
    "TelemetryTls",
    "any_section_of",
    "asked",
    "cautions",
    "certificate_end",
    "certificate_ends",
    "credential_problems",
    "data_of",
    "described",
    "draft",
    "endpoint",
    "inputs_if_known",
    "inputs_of_config",
    "key_prefix",
    "kinds_in",
    "load",
    "load_talc_only",
    "machine_name",
    "other_kinds",
    "outlined",
    "packed_toml",
    "parse",
    "parse_prior",
    "place",
    "prior_for",
    "read_as",
    "read_sections",
    "read_text",
    "sections_of_others",
    "shown",
    "step_s_of",
    "stored_configuration",
    "suggestion",
    "toml_value",
    "unarmed",
    "unpacked",
    "validate",
    "wires_toml",
]
