"""`[telemetry]`: what `check` refuses of endpoints, certificates, keys, passwords and readers, and in which words."""

from collections.abc import Callable
from datetime import timedelta
from pathlib import Path

import pytest
from cryptography.x509 import load_pem_x509_certificate

from drivers.credential_files import secret_cautions
from gateway.config.file import parse
from gateway.config.model import GatewayConfig
from gateway.config.rules import cautions
from gateway.config.telemetry import endpoint
from tests.benches.command import here
from tests.benches.plant_authority import DAY, PlantAuthority
from tests.benches.service_file import TEXT

OPEN = "'tcp/0.0.0.0:7447' can be reached and read by everyone in that network: expected tls/"
SHAPE = "expected PROTOCOL/HOST:PORT such as tcp/127.0.0.1:7447 or tls/0.0.0.0:7447"
PEM = """[telemetry.tls]
certificate = "plant/mill.pem"
key = "plant/mill.key"
authority = "plant/authority.pem"
mutual = true
"""
LISTEN_TLS = f'[telemetry]\nlisten = ["tls/0.0.0.0:7447"]\n{PEM}'


def checked(folder: Path, telemetry: str) -> tuple[int, str]:
    """Exit code and output of `talc-gateway check`."""
    file = folder / "gateway.toml"
    file.write_text(f"{TEXT}\n{telemetry}", encoding="utf-8")
    done = here("check", file)
    return done.code, done.together.replace(f"{folder}/", "")


def config(telemetry: str) -> GatewayConfig:
    return parse(f"{TEXT}\n{telemetry}", Path("gateway.toml"))


@pytest.mark.parametrize(
    ("telemetry", "said"),
    [
        ('listen = ["tcp/nonsense"]', f"[telemetry] listen[0]: 'tcp/nonsense': {SHAPE}"),
        ('listen = ["7447"]', f"[telemetry] listen[0]: '7447': {SHAPE}"),
        ('connect = ["http/router:80"]', f"[telemetry] connect[0]: 'http/router:80': {SHAPE}"),
        ('listen = ["tcp/127.0.0.1:0"]', f"[telemetry] listen[0]: 'tcp/127.0.0.1:0': {SHAPE}"),
        ('listen = ["tcp/127.0.0.1:70000"]', f"'tcp/127.0.0.1:70000': {SHAPE}"),
        ('listen = ["tcp/0.0.0.0:7447"]', OPEN),
        ('listen = ["tcp/0.0.0.0:7447"]', "allow_unencrypted = true to keep it as it is"),
        ('listen = ["tcp/[::]:7447"]', "'tcp/[::]:7447' can be reached"),
        ('listen = ["udp/mill.plant.example:7447"]', "'udp/mill.plant.example:7447' can be reached"),
        ('listen = ["tls/0.0.0.0:7447"]', "'tls/0.0.0.0:7447' needs [telemetry.tls] certificate and key"),
        ('connect = ["tls/router:7447"]', "'tls/router:7447' needs [telemetry.tls] authority"),
        ('user = "mill"', "[telemetry]: user and password_file go together: give both or neither"),
        ('readers = ["alice"]', "[telemetry] readers: needs clients with names"),
        (
            'readers = ["alice"]\nusers_file = "users"\nconnect = ["tcp/127.0.0.1:7448"]',
            "[telemetry] readers: does not limit who reads from the router of `connect`",
        ),
        ('tls = { certificate = "a.pem" }', "[telemetry.tls]: certificate and key go together"),
        ("tls = { mutual = true }", "[telemetry.tls] mutual: true: expected certificate, key and authority too"),
    ],
)
def test_what_contradicts_itself_is_refused(tmp_path: Path, telemetry: str, said: str) -> None:
    code, output = checked(tmp_path, f"[telemetry]\n{telemetry}\n")
    assert code == 2
    assert said in output


@pytest.mark.parametrize(
    "telemetry",
    [
        "",
        'listen = ["tcp/0.0.0.0:7447"]\nallow_unencrypted = true',
        'listen = ["tcp/localhost:7447", "tcp/[::1]:7447", "unixsock-stream//run/talc.sock"]',
        'mode = "client"\nlisten = ["tcp/0.0.0.0:7447"]\nconnect = ["tcp/127.0.0.1:7448"]',
        'enabled = false\nlisten = ["tcp/0.0.0.0:7447"]',
    ],
)
def test_what_is_safe_or_wanted_passes(tmp_path: Path, telemetry: str) -> None:
    code, output = checked(tmp_path, f"[telemetry]\n{telemetry}\n")
    assert (code, "good" in output) == (0, True)


def spoil(name: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        (folder / "plant" / name).write_text("nothing of the kind", encoding="utf-8")

    return change


def remove(name: str) -> Callable[[Path], None]:
    return lambda folder: (folder / "plant" / name).unlink()


def others_key(folder: Path) -> None:
    _, key = PlantAuthority(folder / "other").issue("mill")
    key.rename(folder / "plant" / "mill.key")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (remove("mill.pem"), "[telemetry.tls] certificate: 'plant/mill.pem' cannot be read: No such file"),
        (remove("mill.key"), "[telemetry.tls] key: 'plant/mill.key' cannot be read: No such file"),
        (remove("authority.pem"), "[telemetry.tls] authority: 'plant/authority.pem' cannot be read: No such file"),
        (spoil("mill.pem"), "'plant/mill.pem': expected certificates in PEM"),
        (spoil("mill.key"), "'plant/mill.key': expected a private key in PEM without a password"),
        (others_key, "[telemetry.tls] key: 'plant/mill.key' does not belong to the certificate 'plant/mill.pem'"),
    ],
)
def test_files_that_are_missing_spoilt_or_of_others_are_refused(
    tmp_path: Path, change: Callable[[Path], None], said: str
) -> None:
    PlantAuthority(tmp_path / "plant").issue("mill")
    assert checked(tmp_path, LISTEN_TLS)[0] == 0
    change(tmp_path)
    code, output = checked(tmp_path, LISTEN_TLS)
    assert code == 2
    assert said in output


def test_an_expired_certificate_is_refused_and_one_that_ends_soon_is_a_warning(tmp_path: Path) -> None:
    authority = PlantAuthority(tmp_path / "plant")
    certificate, _ = authority.issue("mill", -DAY)
    day = load_pem_x509_certificate(certificate.read_bytes()).not_valid_after_utc.date()
    code, output = checked(tmp_path, LISTEN_TLS)
    assert code == 2
    assert f"[telemetry.tls] certificate: 'plant/mill.pem' has expired on {day}" in output
    authority.issue("mill", timedelta(days=20))
    code, output = checked(tmp_path, LISTEN_TLS)
    assert code == 0
    assert "warning: gateway.toml: [telemetry.tls] certificate: 'plant/mill.pem' expires on" in output


@pytest.mark.parametrize(
    ("users", "said"),
    [
        ("", "'users' is empty: nobody could connect"),
        ("alice:wonderland\nbob\n", "'users', line 2: expected user:password"),
        (None, "'users' cannot be read: No such file"),
        ("\n\ufeffalice:wonderland\n", "'users', line 2: '\\ufeffalice:wonderland' contains an invisible character"),
        ("al\0ice:wonderland\n", "'users', line 1: 'al\\x00ice:wonderland' contains an invisible character"),
    ],
)
def test_a_file_of_users_has_a_password_for_each(tmp_path: Path, users: str | None, said: str) -> None:
    if users is not None:
        (tmp_path / "users").write_text(users, encoding="utf-8")
    code, output = checked(tmp_path, '[telemetry]\nusers_file = "users"\n')
    assert code == 2
    assert f"[telemetry] users_file: {said}" in output


@pytest.mark.parametrize("users", ["", ".", "/"])
def test_an_invalid_file_of_users_is_refused(tmp_path: Path, users: str) -> None:
    code, output = checked(tmp_path, f'[telemetry]\nusers_file = "{users}"\n')
    assert code == 2
    assert f"[telemetry] users_file: {str(Path(users))!r}: expected the path of a file" in output


def test_what_is_less_safe_than_it_could_be_is_a_warning(tmp_path: Path) -> None:
    text = '[telemetry]\nconnect = ["tcp/192.168.1.5:7447"]\nmulticast = true\nusers_file = "users"\n'
    (tmp_path / "users").write_text("alice:wonderland\n")
    (tmp_path / "users").chmod(0o644)
    code, output = checked(tmp_path, text)
    assert code == 0
    for said in (
        "connect: 'tcp/192.168.1.5:7447' is reached without encryption; use tls/",
        "multicast: true: connects to anyone who answers in this network",
        "users_file: 'users' can be read by other users; chmod 600",
    ):
        assert f"warning: gateway.toml: [telemetry] {said}" in output
    assert not [caution for caution in cautions(config("")) if "telemetry" in str(caution)]


@pytest.mark.parametrize(("mode", "warned"), [(0o640, False), (0o644, True)])
def test_the_group_of_the_programs_beside_the_gateway_may_read_a_secret(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mode: int, warned: bool
) -> None:
    users = tmp_path / "users"
    users.write_text("alice:wonderland\n")
    users.chmod(mode)
    monkeypatch.setattr("drivers.credential_files.SHARING_GROUP", users.group())
    assert bool(list(secret_cautions(users))) is warned


@pytest.mark.parametrize(
    ("listens", "reached"),
    [
        ("tls/0.0.0.0:7447", "tls/127.0.0.1:7447"),
        ("tcp/[::]:7448", "tcp/[::1]:7448"),
        ("tcp/192.168.1.5:7447", "tcp/192.168.1.5:7447"),
        ("tcp/mill.plant.example:7447", "tcp/mill.plant.example:7447"),
    ],
)
def test_a_gateway_that_listens_on_every_address_is_reached_by_loopback(listens: str, reached: str) -> None:
    assert endpoint(listens).from_here == reached
