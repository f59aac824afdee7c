"""The page's program at an address that others reach: nobody sees anything without TLS and a password."""

import ssl
from base64 import b64encode
from collections.abc import Iterator
from contextlib import closing, contextmanager
from http.client import HTTPConnection, HTTPException, HTTPResponse, HTTPSConnection
from pathlib import Path
from urllib.parse import urlsplit

import msgspec
import pytest

from gateway.runtime.passwords import make_hash
from tests.benches.free_port import free_port
from tests.benches.page_rig import ChildProgram
from tests.benches.plant_authority import PlantAuthority

pytestmark = pytest.mark.slow

PASSWORD = "grüezi"
LIMIT_S = 60.0


@contextmanager
def served(folder: Path) -> Iterator[tuple[int, Path]]:
    """Its port on all addresses of this computer, and the authority of its certificate, which lasts for 90 days."""
    authority = PlantAuthority(folder / "plant")
    certificate, key = authority.issue("page")
    settings = folder / "web.toml"
    settings.write_text(
        f'[tls]\ncertificate = "{certificate}"\nkey = "{key}"\n[users]\nanna = "{make_hash(PASSWORD)}"\n'
        "[machine.mill]\ntolerance_um = 8.0\n",
        encoding="utf-8",
    )
    nobody = f"tcp/127.0.0.1:{free_port()}"
    program = ChildProgram(
        "gateway", "web", "--connect", nobody, "--settings", str(settings), "--listen", "0.0.0.0:0"
    )  # fmt: skip
    try:
        address = urlsplit(program.hear())
        assert (address.scheme, address.hostname) == ("https", "0.0.0.0")
        assert address.port is not None
        yield address.port, authority.path
    finally:
        program.kill()


def asked(browser: HTTPConnection, path: str, password: str | None = None, method: str = "GET") -> HTTPResponse:
    """The answer to anna, or to somebody without a name."""
    basic = "Basic " + b64encode(f"anna:{password}".encode()).decode()
    browser.request(method, path, headers={} if password is None else {"authorization": basic})
    return browser.getresponse()


def test_tls_and_a_password_open_the_page_and_nothing_else_does(tmp_path: Path) -> None:
    with served(tmp_path) as (port, authority):
        known = ssl.create_default_context(cafile=authority)
        with closing(HTTPSConnection("localhost", port, timeout=LIMIT_S, context=known)) as browser:
            paths = ("/", "/machine/mill", "/stream/mill", "/past/mill", "/file/0/page.js")
            for path, password in (*((path, None) for path in paths), *((path, "gruezi") for path in paths[1:])):
                refused = asked(browser, path, password)
                refused.read()
                assert refused.status == 401, path
            assert b'data-machine="mill"' in asked(browser, "/machine/mill", PASSWORD).read()
            command = asked(browser, "/command/mill/pause", PASSWORD, "POST")
            command.read()
            assert command.status == 405, "no operator is named"
            stream = asked(browser, "/stream/mill", PASSWORD)
            while stream.readline() != b"event: view\n":
                assert not stream.isclosed()
            health = msgspec.json.decode(stream.readline().removeprefix(b"data: "))["health"]
            (own,) = [row["said"] for row in health if row["label"] == "label.certificate"]
            assert own["values"]["field"]["s"] == "[tls] certificate"
            assert own["values"]["n"]["n"] == 89, "90 days, less the seconds since"
        with (
            closing(HTTPConnection("localhost", port, timeout=LIMIT_S)) as plain,
            pytest.raises((ConnectionError, HTTPException)),
        ):
            asked(plain, "/")
        stranger = HTTPSConnection("localhost", port, timeout=LIMIT_S, context=ssl.create_default_context())
        with closing(stranger), pytest.raises(ssl.SSLCertVerificationError):
            asked(stranger, "/")
