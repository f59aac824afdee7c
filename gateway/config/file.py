"""Loads and checks a configuration file: its text, then its sections, then what they are together."""

from collections.abc import Mapping
from pathlib import Path

from gateway.config.extended import read_configuration
from gateway.config.model import GatewayConfig
from gateway.config.problems import located
from gateway.config.reading import data_of, read_text
from gateway.config.rules import checked


def load(path: Path) -> GatewayConfig:
    """The checked configuration of a file. Uses no network.

    Raises ConfigError with every problem found.
    """
    return parse(read_text(path), path)


def parse(text: str, path: Path) -> GatewayConfig:
    """The checked configuration of a text; `path` names it in messages, and relative paths start at its folder.

    Raises ConfigError with every problem found.
    """
    with located(text):
        return from_data(data_of(text, path), path)


def draft(text: str, path: Path) -> GatewayConfig:
    """The content of a text so far: each field is valid, but they need not fit together. Raises ConfigError."""
    with located(text):
        return read_configuration(data_of(text, path), path)


def from_data(data: Mapping[str, object], path: Path) -> GatewayConfig:
    """The checked configuration of TOML's data. Raises ConfigError with every problem found."""
    return checked(read_configuration(data, path), path)
