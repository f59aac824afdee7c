"""Commands from the page: only of a signed-in user with a key, and only from the page itself."""

import re
from pathlib import Path

import pytest
from starlette.testclient import TestClient

from drivers.base import SetupError
from gateway.config.problems import ConfigError
from gateway.listeners.web.app import build_app
from gateway.listeners.web.settings import Proxy, WebSettings, load_settings
from gateway.model.commands import CommandName
from gateway.runtime.passwords import make_hash
from gateway.telemetry.answers import CommandAnswer
from gateway.telemetry.command_signer import CommandSigner
from gateway.telemetry.subscriber.site import SiteSeen
from tests.benches.heard import BEGAN
from tests.benches.mill_page import logged_in, mill_seen
from tests.benches.refusals import refusing

HASHED = make_hash("secret")
PROXY = Proxy(header="X-User", addresses=("10.0.0.2",))
PAUSE = "/command/mill/pause"


class CommandedPages:
    """The application, its users anna and ben with a key each, eve without one, and what it passed on."""

    def __init__(self, folder: Path, proxy: Proxy | None = None, address: str = "127.0.0.1") -> None:
        self.given: list[tuple[str, str, CommandName]] = []
        self.answer: CommandAnswer | OSError = CommandAnswer("mill", "pause", "anna", "", accepted=True, text="done")
        for name in ("anna", "ben"):
            (folder / f"{name}.key").write_text(name * 20, encoding="utf-8")
        settings = WebSettings(
            users={} if proxy else dict.fromkeys(("anna", "ben", "eve"), HASHED),
            operators={name: folder / f"{name}.key" for name in ("anna", "ben")},
            proxy=proxy,
        )
        site = mill_seen()
        app = build_app(site, settings, give=self._give)
        self.client = TestClient(app, base_url="https://panel.example", client=(address, 1))

    def _give(self, machine: str, by: CommandSigner, name: CommandName) -> CommandAnswer:
        self.given.append((machine, by.name, name))
        if isinstance(self.answer, OSError):
            raise self.answer
        return self.answer

    def token(self, headers: dict[str, str]) -> str | None:
        html = self.client.get("/machine/mill", headers=headers).text
        found = re.search(r'data-token="(\w+)"', html)
        assert ('id="command-pause"' in html) is (found is not None)
        return None if found is None else found[1]

    def send(self, user: str, token: str, path: str = PAUSE, **more: str) -> tuple[int, str]:
        headers = logged_in(f"{user}:secret") | {"origin": "https://panel.example", "x-command-token": token} | more
        found = self.client.post(path, headers=headers)
        return found.status_code, found.json()["text"] if found.headers["content-type"] == "application/json" else ""


def test_a_user_with_a_key_has_buttons_and_the_gateway_s_answer(tmp_path: Path) -> None:
    pages = CommandedPages(tmp_path)
    token = pages.token(logged_in("anna:secret"))
    assert token is not None
    assert pages.send("anna", token) == (200, "done")
    assert pages.given == [("mill", "anna", CommandName.PAUSE)]
    pages.answer = OSError("no answer within 70 s")
    assert pages.send("anna", token, "/command/mill/measure") == (502, "no answer within 70 s")


def test_a_user_without_a_key_has_no_button_and_is_refused(tmp_path: Path) -> None:
    pages = CommandedPages(tmp_path)
    assert pages.token(logged_in("eve:secret")) is None
    token = pages.token(logged_in("anna:secret"))
    assert token is not None
    assert pages.send("eve", token) == (403, "this user may give no commands")
    assert pages.client.post(PAUSE).status_code == 401
    assert pages.given == []


@pytest.mark.parametrize(
    "more",
    [
        {"origin": "https://evil.example"},
        {"origin": "null"},
        {"origin": ""},
        {"x-command-token": ""},
        {"x-command-token": "0" * 64},
        {"x-command-token": "ben's"},
    ],
)
def test_what_another_site_makes_the_browser_send_is_refused(more: dict[str, str], tmp_path: Path) -> None:
    pages = CommandedPages(tmp_path)
    token, other = pages.token(logged_in("anna:secret")), pages.token(logged_in("ben:secret"))
    assert token is not None
    assert other is not None
    assert token != other
    if more.get("x-command-token") == "ben's":
        more = {"x-command-token": other}
    status, text = pages.send("anna", token, **more)
    assert (status, text) == (403, "the command did not come from this page; open it again")
    assert pages.given == []


def test_no_other_request_changes_anything(tmp_path: Path) -> None:
    pages = CommandedPages(tmp_path)
    token = pages.token(logged_in("anna:secret"))
    assert token is not None
    headers = logged_in("anna:secret") | {"origin": "https://panel.example", "x-command-token": token}
    assert pages.client.get(PAUSE, headers=headers).status_code == 405
    assert pages.client.options(PAUSE, headers=headers).status_code == 405
    for path in ("/", "/machine/mill", "/stream/mill"):
        assert pages.client.post(path, headers=headers).status_code == 405
    assert pages.send("anna", token, "/command/mill/arm") == (404, "there is no such command")
    assert pages.send("anna", token, "/command/mill*/pause")[0] == 404
    assert pages.given == []


def test_the_user_of_a_proxy_counts_only_from_the_proxy(tmp_path: Path) -> None:
    named = {"X-User": "anna"}
    assert CommandedPages(tmp_path, PROXY, "10.0.0.2").token(named) is not None
    assert CommandedPages(tmp_path, PROXY, "10.0.0.3").token(named) is None
    assert CommandedPages(tmp_path, PROXY, "10.0.0.2").token({"X-User": "eve"}) is None


def test_on_this_computer_without_users_there_are_no_commands(tmp_path: Path) -> None:
    site = mill_seen()
    client = TestClient(build_app(site, WebSettings()), base_url="http://localhost")
    assert "data-token" not in client.get("/machine/mill").text
    assert client.post(PAUSE, headers={"origin": "http://localhost"}).status_code == 405


def test_a_key_that_cannot_be_used_is_named(tmp_path: Path) -> None:
    with refusing(SetupError, "operators.anna: file_wrong"):
        build_app(
            SiteSeen("talc", (), lambda: BEGAN, lambda: 0.0),
            WebSettings(users={"anna": HASHED}, operators={"anna": tmp_path / "absent.key"}),
        )
    file = tmp_path / "web.toml"
    file.write_text('[operators]\nanna = "anna.key"\n', encoding="utf-8")
    with refusing(ConfigError, "[operators]: operators_unknown"):
        load_settings(file)
