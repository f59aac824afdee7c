"""The file of `talc-gateway publish`: where the gateways are heard, and the outlets, also those of other packages."""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import Field, create_model, model_validator

from drivers.section import FilePath, NotEmpty, Section, user_and_password
from gateway.config.fields import DEFAULT_PREFIX, LOOPBACK, KeyPrefix, Name
from gateway.config.problems import ConfigError, Problem, read_sections
from gateway.config.reading import any_section_of, kinds_in, read_data
from gateway.config.telemetry import Endpoint, Telemetry, TelemetryTls, endpoint
from gateway.listeners.outlets.feed import Feed
from gateway.listeners.outlets.influxdb import InfluxDbSettings
from gateway.listeners.outlets.mqtt import MqttOutletSettings
from gateway.listeners.outlets.outlet import Outlet, OutletSettings
from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.telemetry.codec import MESSAGE_TYPES

AnyOutlet = Annotated[MqttOutletSettings | InfluxDbSettings, Field(discriminator="kind")]
_OWN: Mapping[str, type[OutletSettings]] = {"mqtt": MqttOutletSettings, "influxdb": InfluxDbSettings}


class SourceSettings(Section):
    """Where the gateways are heard over Zenoh."""

    connect: tuple[Endpoint, ...] = Field(default=(LOOPBACK,), min_length=1)
    """Zenoh endpoints of gateways or of a router. The default is a gateway on this computer."""
    prefix: KeyPrefix = DEFAULT_PREFIX
    """`[telemetry] prefix` of the gateways."""
    machines: tuple[Name, ...] = ()
    """Machines that are passed on; empty: all that are heard."""
    tls: TelemetryTls = TelemetryTls()
    """As in a gateway's configuration."""
    user: NotEmpty | None = None
    """Where user and password are asked for."""
    password_file: FilePath | None = None
    """File that contains only the user's password."""

    @model_validator(mode="after")
    def _together(self) -> Self:
        user_and_password(self.user, self.password_file)
        return self

    @property
    def telemetry(self) -> Telemetry:
        """The same as a gateway's section. Raises ValueError."""
        return Telemetry(
            listen=(),
            connect=self.connect,
            prefix=self.prefix,
            tls=self.tls,
            user=self.user,
            password_file=self.password_file,
        )


class OutletFile(Section):
    """Which gateways are heard, and where their messages go."""

    source: SourceSettings = SourceSettings()
    outlets: tuple[AnyOutlet, ...] = Field(alias="outlet", min_length=1)

    def feeds(self) -> list[Feed]:
        """One for each outlet. Raises SetupError."""
        return [Feed(settings, _outlet_of(settings)) for settings in self.outlets]


def _outlet_of(settings: AnyOutlet) -> Outlet:
    """Raises SetupError, also for a bug of another package."""
    if settings.kind in _OWN:
        return settings.outlet()
    from gateway.config.extensions import asked  # it loads what no other outlet needs

    made: Callable[[], Outlet] = settings.outlet
    return asked(settings.kind, made)


def _others(data: Mapping[str, object]) -> tuple[list[type[Any]], list[Problem]]:
    """The classes of kinds of other packages, and why some cannot be used."""
    named = list(kinds_in(data, "outlet"))
    if all(kind in _OWN for kind, _ in named):
        return [], []
    from gateway.config.extensions import OUTLETS, sections_of_others

    return sections_of_others(OUTLETS, OutletSettings, _OWN, named)


def _with(sections: list[type[Any]]) -> type[OutletFile]:
    """With the outlets of other packages."""
    if not sections:
        return OutletFile
    several: Any = tuple
    outlet = any_section_of((*_OWN.values(), *sections))
    return create_model(
        "OutletFile",
        __base__=OutletFile,
        __module__=__name__,
        outlets=(several[outlet, ...], Field(alias="outlet", min_length=1)),
    )


def _problems(file: OutletFile) -> Iterator[Problem]:
    tls = file.source.tls
    if tls.authority is None:
        for place in (endpoint(text) for text in file.source.connect):
            if place.encrypted:
                yield Problem("[source] connect", Text(NoticeCode.SOURCE_NO_AUTHORITY, place=place.text))
    seen: set[str] = set()
    for outlet in file.outlets:
        where = f"outlet '{outlet.name}'"
        if outlet.name in seen:
            yield Problem(f"{where}, name", Text(NoticeCode.OUTLET_REPEATED))
        seen.add(outlet.name)
        if impossible := sorted(set(outlet.kinds or ()) - outlet.possible):
            can = tuple(kind for kind in MESSAGE_TYPES if kind in outlet.possible)
            yield Problem(f"{where}, kinds", Text(NoticeCode.OUTLET_KINDS, kinds=impossible, possible=can))


def load_outlets(path: Path) -> OutletFile:
    """The checked file. Raises ConfigError with every problem found."""
    data = read_data(path)
    sections, problems = _others(data)
    if problems:
        raise ConfigError(path, problems)
    found = read_sections(_with(sections), data, path)
    problems = list(_problems(found))
    if problems:
        raise ConfigError(path, problems)
    return found
