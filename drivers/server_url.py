"""Settings of a server that a URL names: its address, and whether the connection is encrypted. No network."""

import re
from typing import ClassVar, Self

from pydantic import field_validator, model_validator

from drivers.bus_settings import is_loopback
from drivers.section import FilePath, Section, host_name, without_brackets, wrong
from drivers.text import Text, shown

_URL = re.compile(r"(?P<scheme>[A-Za-z]+)://(?P<host>\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9._-]+)(?::(?P<port>\d{1,5}))?/?")


class UrlServer(Section):
    """A server with TLS, or without it on this computer."""

    schemes: ClassVar[tuple[str, str]]
    """Schemes of a URL with TLS, and without."""
    default_ports: ClassVar[tuple[int, int]]
    """With TLS, and without."""

    url: str
    """The server: scheme, host and port."""
    allow_unencrypted: bool = False
    """Whether a `url` without TLS may go beyond this computer: everyone in that network can then read and change what
    passes, and read the password."""
    authority: FilePath | None = None
    """Certificates of the authorities (PEM), one of which must have issued the server's certificate. None: those that
    the operating system trusts."""

    @field_validator("url")
    @classmethod
    def _named(cls, url: str) -> str:
        scheme, mark, rest = url.partition("://")
        url = f"{scheme.lower() if mark else scheme}{mark}{rest}"
        found, (safe, plain) = _URL.fullmatch(url), cls.schemes
        if found is None or found["scheme"] not in cls.schemes:
            raise ValueError(Text("server_url_form", value=shown(url), safe=safe, plain=plain))
        if found["port"] is not None and not 1 <= int(found["port"]) <= 0xFFFF:
            raise ValueError(Text("a_port", value=shown(url)))
        host_name(without_brackets(found["host"]))
        return url

    @model_validator(mode="after")
    def _encrypted_or_near(self) -> Self:
        if not (self.encrypted or self.allow_unencrypted or is_loopback(self.host)):
            raise wrong(
                Text("server_unencrypted", value=shown(self.url), scheme=self.schemes[0]),
                "url",
            )
        if self.authority is not None and not self.encrypted:
            raise wrong(Text("authority_without_tls", scheme=self.schemes[0]), "authority")
        return self

    @property
    def encrypted(self) -> bool:
        """Whether it is by TLS."""
        return self.url.startswith(f"{self.schemes[0]}:")

    @property
    def host(self) -> str:
        """Without brackets."""
        return without_brackets(self._part("host"))

    @property
    def port(self) -> int:
        """As stated, or the default one."""
        return int(self._part("port") or self.default_ports[0 if self.encrypted else 1])

    def _part(self, name: str) -> str:
        found = _URL.fullmatch(self.url)
        return "" if found is None else found[name] or ""
