"""Settings of the page beyond a gateway's configuration: who may look, and what the machines are used for."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from pydantic import Field, model_validator

from drivers.section import FilePath, Positive, Section, matching, wrong
from gateway.config.fields import Name
from gateway.config.reading import read_as
from gateway.config.sections import Probing
from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.runtime.passwords import UserName, hash_printed_by


class Tls(Section):
    """The certificate of the page."""

    certificate: FilePath
    """PEM file with the certificate and those between it and the root."""
    key: FilePath
    """PEM file with its private key."""


class Proxy(Section):
    """A reverse proxy that has checked who the user is."""

    header: Annotated[str, matching(r"[A-Za-z0-9-]+", NoticeCode.A_HEADER)]
    """Header in which it names the user. The proxy must remove this header from what browsers send."""
    addresses: tuple[str, ...] = Field(min_length=1)
    """Addresses of the proxy; from others the header counts for nothing."""


_SHIPPED = Probing()


class MachineUse(Section):
    """What is declared of one machine."""

    tolerance_um: Positive | None = None
    """Tolerance of the job: how far the tool may be off in X, Y or Z. A browser may set another one for itself."""
    sphere_radius_mm: Positive = _SHIPPED.sphere_radius_mm
    """[probing] sphere_radius_mm of its gateway, for one of before `sphere_mm`, which does not tell it."""
    sphere_height_mm: float = _SHIPPED.sphere_height_mm
    """[probing] sphere_height_mm of its gateway."""


class WebSettings(Section):
    """The page's own file."""

    tls: Tls | None = None
    proxy: Proxy | None = None
    users: Mapping[UserName, Annotated[str, hash_printed_by("web")]] = Field(default_factory=dict)
    """Name and password hash of everybody who may look."""
    hosts: tuple[str, ...] = ()
    """Names by which browsers call this computer, beside localhost; of a page without users others are refused."""
    operators: Mapping[str, FilePath] = Field(default_factory=dict)
    """Users who may give commands, and the file of each one's key: as in [[telemetry.operator]] of the gateways."""
    machines: Mapping[Name, MachineUse] = Field(default_factory=dict, alias="machine")
    """By name of the machine."""

    @model_validator(mode="after")
    def _known(self) -> "WebSettings":
        unknown = [] if self.proxy is not None else sorted(set(self.operators) - set(self.users))
        if unknown:
            raise wrong(Text(NoticeCode.OPERATORS_UNKNOWN, names=unknown), "operators")
        return self


def load_settings(path: Path | None) -> WebSettings:
    """The checked file; without one the page is only for this computer. Raises ConfigError."""
    if path is None:
        return WebSettings()
    return read_as(WebSettings, path)
