"""Loads and checks a configuration file."""

from collections.abc import Mapping
from pathlib import Path

from drivers.base import SetupError
from drivers.profiles import UserProfile, is_users, user_profile
from gateway.config.extended import config_class
from gateway.config.model import GatewayConfig, with_database
from gateway.config.prior import PriorError, prior_for
from gateway.config.problems import ConfigError, Problem, read_sections
from gateway.config.reading import data_of, read_text
from gateway.config.rules import problems_between


def load(path: Path) -> GatewayConfig:
    """The checked configuration of a file. Uses no network.

    Raises ConfigError with every problem found.
    """
    return parse(read_text(path), path)


def parse(text: str, path: Path) -> GatewayConfig:
    """The checked configuration of a text; `path` names it in messages, and relative paths start at its folder.

    Raises ConfigError with every problem found.
    """
    return from_data(data_of(text, path), path)


def draft(text: str, path: Path) -> GatewayConfig:
    """The content of a text so far: each field is valid, but they need not fit together. Raises ConfigError."""
    return _validated(data_of(text, path), path)


def from_data(data: Mapping[str, object], path: Path) -> GatewayConfig:
    """The checked configuration of TOML's data. Raises ConfigError with every problem found."""
    config, unreadable = _with_own_profiles(_validated(data, path))
    problems, prior = problems_between(config), None
    try:
        prior = prior_for(config.talc, config.input_names)
    except PriorError as error:
        problems.append(Problem("[talc] prior", str(error)))
    if problems or unreadable:
        raise ConfigError(path, problems or unreadable)
    return config.with_prior(prior)


def _with_own_profiles(config: GatewayConfig) -> tuple[GatewayConfig, list[Problem]]:
    """The user's own profiles are read here once, so that what was checked is what runs. Also what cannot be read; a
    device's check reports it with the device."""
    profiles: dict[str, UserProfile] = {}
    unreadable: list[Problem] = []
    others = {bus.name for bus in config.buses if not bus.has_profiles}
    devices = (device for device in config.devices if device.bus not in others)
    for name in dict.fromkeys(device.profile for device in devices if is_users(device.profile)):
        try:
            profiles[name] = user_profile(name)
        except SetupError as error:
            unreadable.append(Problem("", str(error)))
    return config.with_profiles(profiles), unreadable


def _validated(data: Mapping[str, object], path: Path) -> GatewayConfig:
    kind, unusable = config_class(data)
    if unusable:
        raise ConfigError(path, unusable)
    return read_sections(kind, with_database(data), path)
