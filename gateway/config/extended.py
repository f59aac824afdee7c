"""The class of a configuration that uses kinds of other packages: GatewayConfig with their sections added."""

import json
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any, get_args

from pydantic import Field, TypeAdapter, create_model

from drivers.section import strictly
from gateway.config.buses import SECTIONS
from gateway.config.controls import Nc
from gateway.config.extensions import (
    BUSES,
    CONTROLS,
    ControlSection,
    ExtensionError,
    OtherBus,
    extensions,
    section_of,
    sections_of_others,
)
from gateway.config.model import GatewayConfig, with_database
from gateway.config.outline import of_any_program
from gateway.config.problems import ConfigError, Problem, read_sections
from gateway.config.reading import any_section_of, kinds_in


def _sections(union: object) -> dict[str, type[Any]]:
    """Kind to section of a discriminated union."""
    sections = get_args(get_args(union)[0])
    return {str(get_args(section.model_fields["kind"].annotation)[0]): section for section in sections}


_OWN: Mapping[str, Mapping[str, type[Any]]] = {CONTROLS: _sections(Nc), BUSES: SECTIONS}
_BASES: Mapping[str, type[Any]] = {CONTROLS: ControlSection, BUSES: OtherBus}


def read_configuration(data: Mapping[str, object], path: Path) -> GatewayConfig:
    """The sections of TOML's data, each valid by itself. Raises ConfigError with every problem found."""
    kind, unusable = config_class(data)
    if unusable:
        raise ConfigError(path, unusable)
    return read_sections(kind, with_database(data), path)


def config_class(data: Mapping[str, object]) -> tuple[type[GatewayConfig], list[Problem]]:
    """The class for these data of a file, and the kinds that cannot be used."""
    added, problems = dict[str, tuple[type[Any], ...]](), list[Problem]()
    for group, base in _BASES.items():
        named = [(kind, where) for of, kind, where in _kinds(data) if of == group]
        sections, wrong = sections_of_others(group, base, _OWN[group], named)
        added[group] = tuple(sections)
        problems += wrong
    if not any(added.values()):
        return GatewayConfig, problems
    return _extended(added[CONTROLS], added[BUSES]), problems


def other_kinds() -> tuple[list[str], list[str]]:
    """The kinds of other packages that are installed, each with its package; and why others of them cannot be used."""
    usable, broken = [], []
    for group, word in ((CONTROLS, "[nc]"), (BUSES, "[[bus]]")):
        for kind, offered in sorted(extensions(group).items()):
            packages = " and ".join(it.package for it in offered)
            if kind in _OWN[group]:
                broken.append(f"kind '{kind}' of the package {packages} is not used: the gateway has that kind itself")
                continue
            try:
                section_of(kind, offered, _BASES[group])
            except ExtensionError as error:
                broken.append(str(error))
            else:
                usable.append(f"{word} kind '{kind}' ({packages})")
    return usable, broken


def _kinds(data: Mapping[str, object]) -> Iterator[tuple[str, str, str]]:
    """Group, kind and place of each kind in the data."""
    nc = data.get("nc")
    if isinstance(nc, Mapping) and isinstance(nc.get("kind"), str):
        yield CONTROLS, nc["kind"], "[nc], kind"
    yield from ((BUSES, kind, where) for kind, where in kinds_in(data, "bus"))


@cache
def _extended(controls: tuple[type[Any], ...], buses: tuple[type[Any], ...]) -> type[GatewayConfig]:
    several: Any = tuple
    nc, bus = any_section_of((*_OWN[CONTROLS].values(), *controls)), any_section_of((*_OWN[BUSES].values(), *buses))
    return create_model(
        "GatewayConfig",
        __base__=GatewayConfig,
        __module__=__name__,
        nc=(nc | None, None),
        buses=(several[bus, ...], Field(default=(), alias="bus")),
    )


def validate(data: Mapping[str, object], folder: Path | None = None) -> GatewayConfig:
    """A configuration from TOML's data. `folder`: where relative paths start. Raises pydantic.ValidationError."""
    whole = with_database(data)
    return strictly(config_class(whole)[0], whole, {"folder": folder} if folder else None)


def stored_configuration(text: str) -> GatewayConfig:
    """A configuration from `canonical()` text, as the program that stored it understood it.

    Raises ValueError, also as pydantic.ValidationError.
    """
    return validate(of_any_program(TypeAdapter(dict[str, Any]).validate_python(json.loads(text))))
