"""A server's URL: scheme, host, port, and no unencrypted connection beyond this computer unless it is allowed."""

from typing import ClassVar

import pytest

from drivers.base import SetupError
from drivers.problems import settings_of
from drivers.server_url import UrlServer


class HttpServer(UrlServer):
    """A server as an outlet has it."""

    schemes: ClassVar[tuple[str, str]] = ("https", "http")
    default_ports: ClassVar[tuple[int, int]] = (8443, 8080)


@pytest.mark.parametrize(
    ("url", "encrypted", "host", "port"),
    [
        ("https://plant.example", True, "plant.example", 8443),
        ("https://plant.example:443/", True, "plant.example", 443),
        ("https://[fd00::5]:443", True, "fd00::5", 443),
        ("http://localhost", False, "localhost", 8080),
        ("HTTPS://plant.example", True, "plant.example", 8443),
        ("http://127.0.0.2:80", False, "127.0.0.2", 80),
        ("http://[::1]", False, "::1", 8080),
    ],
)
def test_a_url_names_host_and_port(url: str, encrypted: bool, host: str, port: int) -> None:
    server = HttpServer(url=url)
    assert (server.encrypted, server.host, server.port) == (encrypted, host, port)


@pytest.mark.parametrize(
    ("fields", "field", "code"),
    [
        ({"url": "plant.example"}, "url", "server_url_form"),
        ({"url": "mqtts://plant.example"}, "url", "server_url_form"),
        ({"url": "https://user:secret@plant.example"}, "url", "server_url_form"),
        ({"url": "https://plant.example:0"}, "url", "a_port"),
        ({"url": "https://plant.example:65536"}, "url", "a_port"),
        ({"url": "https://192.168.0..30"}, "url", "host_form"),
        ({"url": "http://plant.example"}, "url", "server_unencrypted"),
        ({"url": "http://127.0.0.1", "authority": "ca.pem"}, "authority", "authority_without_tls"),
    ],
)
def test_what_is_refused_says_what_to_write(fields: dict[str, str], field: str, code: str) -> None:
    with pytest.raises(SetupError) as raised:
        settings_of(HttpServer, fields)
    assert (raised.value.field, raised.value.what.code) == ((field,), code)


def test_an_unencrypted_connection_can_be_allowed() -> None:
    assert not HttpServer(url="http://plant.example", allow_unencrypted=True).encrypted
