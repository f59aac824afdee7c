"""Who may look, and what a page may load: strict by default."""

from pathlib import Path

import pytest
from click.testing import CliRunner
from starlette.testclient import TestClient

from drivers.base import SetupError
from gateway.cli.main import main
from gateway.config.problems import ConfigError
from gateway.listeners.web.access import check_certificate, check_listening
from gateway.listeners.web.app import build_app
from gateway.listeners.web.settings import Proxy, Tls, WebSettings, load_settings
from gateway.runtime.passwords import is_hash, make_hash, matches
from tests.benches.mill_page import logged_in, mill_seen
from tests.benches.refusals import refusing

ROOT = Path(__file__).parents[4]
TLS = Tls(certificate=Path("page.pem"), key=Path("page.key"))
USERS = {"anna": make_hash("grüezi")}
PROXY = Proxy(header="X-Forwarded-User", addresses=("10.0.0.2",))


def client(settings: WebSettings, address: str = "127.0.0.1", url: str = "http://localhost:8080") -> TestClient:
    site = mill_seen()
    return TestClient(build_app(site, settings), base_url=url, client=(address, 1))


@pytest.mark.parametrize("host", ["127.0.0.1", "::1", "localhost"])
def test_this_computer_needs_nothing(host: str) -> None:
    check_listening(host, WebSettings())


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (WebSettings(), "page_open page_tls page_users"),
        (WebSettings(users=USERS), "page_open page_tls"),
        (WebSettings(tls=TLS), "page_open page_users"),
    ],
)
@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.5", "panel.local", "2130706433"])
def test_an_address_beyond_this_computer_is_refused_without_tls_and_users(
    host: str, settings: WebSettings, said: str
) -> None:
    with refusing(SetupError, said):
        check_listening(host, settings)


@pytest.mark.parametrize("settings", [WebSettings(tls=TLS, users=USERS), WebSettings(tls=TLS, proxy=PROXY)])
def test_with_both_it_is_allowed(settings: WebSettings) -> None:
    check_listening("0.0.0.0", settings)


def test_the_command_refuses_before_it_listens() -> None:
    arguments = ["web", "--connect", "tcp/127.0.0.1:1", "--listen", "0.0.0.0:0"]
    answer = CliRunner().invoke(main, arguments, catch_exceptions=False)
    assert answer.exit_code == 2
    assert "others could reach this address" in answer.output


def test_a_certificate_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    junk = tmp_path / "page.pem"
    junk.write_text("no certificate", encoding="ascii")
    for certificate in (junk, tmp_path / "absent.pem"):
        with pytest.raises(SetupError, match=rf"\[tls\] certificate {certificate}, key .*expected PEM files"):
            check_certificate(Tls(certificate=certificate, key=junk))


def test_a_gateway_that_publishes_nothing_has_no_page(tmp_path: Path) -> None:
    file = tmp_path / "gateway.toml"
    text = (ROOT / "examples" / "sensors-only.toml").read_text("utf-8")
    file.write_text(text.replace("[telemetry]", "[telemetry]\nenabled = false"), encoding="utf-8")
    answer = CliRunner().invoke(main, ["web", str(file)], catch_exceptions=False)
    assert answer.exit_code == 2
    assert "this gateway publishes nothing" in answer.output


@pytest.mark.parametrize("text", ["8080", "localhost:", "host:99999", "::1:8080", "host:x"])
def test_an_invalid_address_is_refused_in_words(text: str) -> None:
    arguments = ["web", "--connect", "tcp/127.0.0.1:1", "--listen", text]
    answer = CliRunner().invoke(main, arguments, catch_exceptions=False)
    assert answer.exit_code == 2
    assert "expected HOST:PORT" in answer.output


def test_the_command_makes_a_hash_that_the_settings_take(tmp_path: Path) -> None:
    answer = CliRunner().invoke(main, ["web", "--make-password"], input="grüezi\ngrüezi\n", catch_exceptions=False)
    found = answer.stdout.splitlines()[-1]
    assert matches("grüezi", found)
    file = tmp_path / "web.toml"
    file.write_text(f'[users]\nanna = "{found}"\n[machine.mill]\ntolerance_um = 8\n', encoding="utf-8")
    settings = load_settings(file)
    assert settings.users == {"anna": found}
    assert settings.machines["mill"].tolerance_um == 8


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('[users]\nanna = "secret"', "expected what `talc-gateway web --make-password` prints"),
        ("[tls]\ncertificate = 'a.pem'", "key"),
        ("user = 1", "user"),
        ("[machine.mill]\ntolerance_um = -1", "tolerance_um"),
    ],
)
def test_settings_that_are_wrong_are_refused_with_the_field(tmp_path: Path, text: str, said: str) -> None:
    file = tmp_path / "web.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=said):
        load_settings(file)


def test_each_hash_has_its_own_salt_and_another_password_does_not_fit() -> None:
    first, second = make_hash("a"), make_hash("a")
    assert first != second
    assert matches("a", second)
    assert not matches("b", second)


@pytest.mark.parametrize(
    "text", ["", "a", "scrypt$16384$8$1$AAAA$AAAA", "scrypt$1073741824$8$1$AAAA$" + "A" * 43 + "=", "md5$1$1$1$A$A"]
)
def test_an_invalid_hash_never_matches(text: str) -> None:
    assert not is_hash(text)
    assert not matches("", text)


def test_on_this_computer_another_sites_name_is_refused() -> None:
    """A web site that resolves to 127.0.0.1 cannot read the page through the operator's browser."""
    page = client(WebSettings())
    assert page.get("/machine/mill").status_code == 200
    assert page.get("/machine/mill", headers={"host": "evil.example:8080"}).status_code == 421
    assert client(WebSettings(hosts=("panel",)), url="http://panel:8080").get("/machine/mill").status_code == 200


@pytest.mark.parametrize(("host", "code"), [("[::1]:8080", 200), ("[::1]", 200), ("[fd00::1]:8080", 421)])
def test_only_this_computers_own_ipv6_address_is_let_in(host: str, code: int) -> None:
    assert client(WebSettings(), url=f"http://{host}").get("/machine/mill").status_code == code


def test_with_users_every_address_needs_the_password() -> None:
    page = client(WebSettings(tls=TLS, users=USERS), "192.168.1.9", "https://panel")
    for path in ("/", "/machine/mill", "/stream/mill", "/file/0/page.js"):
        refused = page.get(path)
        assert (refused.status_code, refused.headers["www-authenticate"][:5]) == (401, "Basic")
    for wrong in ("anna:gruezi", "anna:", "anna", "otto:grüezi", ":grüezi"):
        assert page.get("/machine/mill", headers=logged_in(wrong)).status_code == 401
    assert page.get("/machine/mill", headers={b"authorization": b"Basic \xff\xff"}).status_code == 401
    for _ in range(2):
        assert page.get("/machine/mill", headers=logged_in("anna:grüezi")).status_code == 200


def test_after_five_wrong_passwords_from_an_address_no_other_one_is_looked_at_there() -> None:
    settings = WebSettings(tls=TLS, users=USERS)
    app = build_app(mill_seen(), settings)
    here, there = (TestClient(app, base_url="https://panel", client=(f"192.168.1.{n}", 1)) for n in (9, 10))
    assert there.get("/machine/mill", headers=logged_in("anna:grüezi")).status_code == 200
    for guess in range(5):
        assert here.get("/machine/mill", headers=logged_in(f"otto{guess}:1")).status_code == 401, "not a user"
    refused = here.get("/machine/mill", headers=logged_in("anna:1"))
    assert (refused.status_code, refused.headers["retry-after"]) == (429, "1")
    assert here.get("/machine/mill").status_code == 401, "nothing was guessed"
    assert there.get("/machine/mill", headers=logged_in("anna:2")).status_code == 401, "it is looked at"
    assert here.get("/machine/mill", headers=logged_in("anna:grüezi")).status_code == 200, "it was right before"


def test_only_the_proxys_header_counts() -> None:
    settings = WebSettings(tls=TLS, proxy=PROXY)
    named = {"x-forwarded-user": "anna"}
    assert client(settings, "10.0.0.2").get("/machine/mill", headers=named).status_code == 200
    assert client(settings, "10.0.0.2").get("/machine/mill").status_code == 403
    assert client(settings, "10.0.0.3").get("/machine/mill", headers=named).status_code == 403
    two = [*named.items(), ("x-forwarded-user", "eve")]  # one of them is the browser's own
    assert client(settings, "10.0.0.2").get("/machine/mill", headers=two).status_code == 403


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS"])
def test_nothing_can_be_written(method: str) -> None:
    assert client(WebSettings()).request(method, "/machine/mill").status_code == 405


@pytest.mark.parametrize(
    "path", ["/machine/mill", "/machine/a*b", "/file/0/page.js", "/file/0/..%2faccess.py", "/stream/a*b"]
)
def test_every_answer_forbids_what_is_not_of_this_server(path: str) -> None:
    headers = client(WebSettings()).get(path).headers
    policy = headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert "http" not in policy
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["cache-control"] == "no-store"


@pytest.mark.parametrize(
    "query", ["tolerance=-1", "tolerance=nan", "x=inf", "z=1e9", "a=left", "x=1_0", "x=١٢", "y=%201"]
)
def test_an_invalid_point_is_refused(query: str) -> None:
    answer = client(WebSettings()).get(f"/stream/mill?{query}")
    assert (answer.status_code, "expected a number" in answer.text) == (400, True)
