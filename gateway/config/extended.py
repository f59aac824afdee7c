"""The class of a configuration that uses kinds of other packages: GatewayConfig with their sections added."""

import json
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Union, get_args

from pydantic import Field, create_model

from drivers.section import strictly
from gateway.config.buses import BusSection
from gateway.config.controls import Nc
from gateway.config.extensions import BUSES, CONTROLS, ExtensionError, extensions, section_of
from gateway.config.model import GatewayConfig, with_database
from gateway.config.problems import Problem


def _sections(union: object) -> dict[str, type[Any]]:
    """Kind to section of a discriminated union."""
    sections = get_args(get_args(union)[0])
    return {str(get_args(section.model_fields["kind"].annotation)[0]): section for section in sections}


_OWN = {CONTROLS: _sections(Nc), BUSES: _sections(BusSection)}


def config_class(data: Mapping[str, object]) -> tuple[type[GatewayConfig], list[Problem]]:
    """The class for these data of a file, and the kinds that cannot be used."""
    added: dict[str, dict[str, type[Any]]] = {CONTROLS: {}, BUSES: {}}
    problems = []
    for group, kind, where in _kinds(data):
        if kind in _OWN[group]:
            continue
        offered = extensions(group)
        for name in [kind] if kind in offered else offered:  # of an unknown kind the message tells all that there are
            try:
                added[group][name] = section_of(name, offered[name])
            except ExtensionError as error:
                if name == kind:
                    problems.append(Problem(where, str(error)))
    if not any(added.values()):
        return GatewayConfig, problems
    return _extended(tuple(added[CONTROLS].values()), tuple(added[BUSES].values())), problems


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
                section_of(kind, offered)
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
    buses = data.get("bus")
    for number, bus in enumerate(buses if isinstance(buses, list) else (), start=1):
        if isinstance(bus, Mapping) and isinstance(bus.get("kind"), str):
            name = bus.get("name")
            yield BUSES, bus["kind"], f"bus '{name}', kind" if isinstance(name, str) else f"bus number {number}, kind"


@cache
def _extended(controls: tuple[type[Any], ...], buses: tuple[type[Any], ...]) -> type[GatewayConfig]:
    union: Any = Union  # made of values, which a type checker does not follow
    several: Any = tuple
    nc: Any = Annotated[union[(*_OWN[CONTROLS].values(), *controls)], Field(discriminator="kind")]
    bus: Any = Annotated[union[(*_OWN[BUSES].values(), *buses)], Field(discriminator="kind")]
    return create_model(
        "GatewayConfig",
        __base__=GatewayConfig,
        __module__=__name__,
        nc=(nc | None, None),
        buses=(several[bus, ...], Field(default=(), alias="bus")),
    )


def validate(data: Mapping[str, object] | str, folder: Path | None = None) -> GatewayConfig:
    """A configuration from TOML's data, or from `canonical()` text.

    `folder`: where relative paths start. Raises pydantic.ValidationError.
    """
    whole = _of_any_program(data) if isinstance(data, str) else with_database(data)
    return strictly(config_class(whole)[0], whole, {"folder": folder} if folder else None)


def _of_any_program(canonical: str) -> Mapping[str, object]:
    """All defaults are written out, so a text without a method is from a program that had only the models."""
    whole: dict[str, object] = json.loads(canonical)
    talc = whole.get("talc")
    return {**whole, "talc": {"method": "models", **talc}} if isinstance(talc, dict) else whole
