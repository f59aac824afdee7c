"""Typed configuration of one gateway: one TOML file in, one frozen value out, clear messages when it is invalid."""

from gateway.config.load import load, parse
from gateway.config.model import Channel, GatewayConfig
from gateway.config.problems import ConfigError, Problem
from gateway.config.rules import cautions

__all__ = ["Channel", "ConfigError", "GatewayConfig", "Problem", "cautions", "load", "parse"]
