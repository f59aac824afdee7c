"""Signed, encrypted, with user and certificates; and the messages when one of them is wrong."""

import asyncio
from collections.abc import AsyncIterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from click.testing import CliRunner
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from drivers.base import DriverError, Quality, Refused, SetupError, SystemClock
from drivers.build import make_device
from drivers.opcua.certificates import key_cautions
from drivers.opcua.new_certificate import make_certificate
from drivers.problems import settings_of
from drivers.sinumerik.control import Sinumerik
from drivers.sinumerik.settings import SinumerikSettings
from gateway.cli.main import main
from gateway.runtime.clocks import RealClock
from simulators.nc import Activity, DayPart, EmulatedControl, LoadCase, MeanLoads, Security, User
from simulators.nc.access import APPLICATION_URI
from tests.benches.buses import make_bus
from tests.benches.emulated_bench import Rigid

pytestmark = pytest.mark.simulated_time

GATEWAY_URI = "urn:talc:gateway:test"


@dataclass(frozen=True)
class Pair:
    certificate: Path
    key: Path


def make_pair(folder: Path, name: str, uri: str | None, *, days: tuple[float, float] = (-1, 30)) -> Pair:
    """A self-signed application instance certificate (OPC UA Part 6, 6.2.2) and its key."""
    key = rsa.generate_private_key(public_exponent=65537, key_size=2048)
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    begin, end = (datetime.now(UTC) + timedelta(days=d) for d in days)
    builder = x509.CertificateBuilder().subject_name(subject).issuer_name(subject).public_key(key.public_key())
    builder = builder.serial_number(x509.random_serial_number()).not_valid_before(begin).not_valid_after(end)
    builder = builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
    usage = [ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH]
    builder = builder.add_extension(x509.ExtendedKeyUsage(usage), critical=False)
    if uri is not None:
        names = [x509.UniformResourceIdentifier(uri), x509.DNSName("localhost")]
        builder = builder.add_extension(x509.SubjectAlternativeName(names), critical=False)
    certificate = builder.sign(key, hashes.SHA256())
    pair = Pair(folder / f"{name}.der", folder / f"{name}_key.pem")
    pair.certificate.write_bytes(certificate.public_bytes(serialization.Encoding.DER))
    pair.key.write_bytes(
        key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    )
    return pair


@dataclass(frozen=True)
class EncryptedSite:
    """A control that only speaks encrypted, and what the gateway needs to get in."""

    folder: Path
    control: EmulatedControl
    url: str
    ours: Pair
    theirs: Pair

    def driver(self, **changes: object) -> Sinumerik:
        password = self.folder / "password"
        password.write_text(str(changes.pop("password", "secret")) + "\n")
        fields: dict[str, object] = {
            "url": self.url,
            "security": "Basic256Sha256",
            "user": "gateway",
            "password_file": password,
            "certificate": self.ours.certificate,
            "private_key": self.ours.key,
            "server_certificate": self.theirs.certificate,
        }
        return Sinumerik(settings_of(SinumerikSettings, fields | changes), SystemClock())


@pytest.fixture
async def site(tmp_path: Path) -> AsyncIterator[EncryptedSite]:
    ours, theirs = Pair(*make_certificate(tmp_path, "mill-7")), make_pair(tmp_path, "control", APPLICATION_URI)
    control = EmulatedControl(
        Rigid(),
        RealClock(),
        LoadCase([DayPart(0.0, 1e9, Activity.PAUSE, MeanLoads())]),
        users={"gateway": User("secret")},
        security=Security(theirs.certificate, theirs.key, (ours.certificate,)),
    )
    url = await control.start()
    yield EncryptedSite(tmp_path, control, url, ours, theirs)
    await control.stop()
    await asyncio.get_running_loop().shutdown_default_executor()


@pytest.mark.parametrize(
    ("policy", "pinned"),
    [("Basic256Sha256", True), ("Aes128_Sha256_RsaOaep", False), ("Aes256_Sha256_RsaPss", True)],
)
async def test_signed_and_encrypted_with_user_and_certificate(site: EncryptedSite, policy: str, pinned: bool) -> None:
    changed = {} if pinned else {"server_certificate": None}
    nc = site.driver(security=policy, **changed)
    await nc.connect()
    await nc.write_compensation((1.0, -2.0, 3.0))
    assert await nc.read_compensation() == pytest.approx((1.0, -2.0, 3.0))
    await nc.close()


async def test_a_bus_beside_the_control_reads_temperatures_with_the_same_credentials(site: EncryptedSite) -> None:
    """Two sessions: whatever happens to the one that reads channels never ends the one that writes offsets."""
    nc = site.driver()
    await nc.connect()
    await nc.write_compensation((1.0, -2.0, 3.0))
    profile = site.folder / "control.toml"
    text = 'protocol = "opcua"\ntitle = "c"\nunit = "mm"\nnamespace = "SinumerikVarProvider"\n'
    profile.write_text(text + '[[node]]\nnode = "s=/NC/_N_AX_SEA_ACX/$SA_TEMP_COMP_ABS_VALUE[u2]"\n')
    fields: dict[str, object] = {
        "url": site.url,
        "user": "gateway",
        "password_file": str(site.folder / "password"),
        "certificate": str(site.ours.certificate),
        "private_key": str(site.ours.key),
        "server_certificate": str(site.theirs.certificate),
    }
    bus = make_bus("control", "opcua", fields)
    device = make_device("k0", bus, str(profile), 1, {"k0_Y": 0}, {}, SystemClock())
    await bus.connect()
    (reading,) = await device.read()
    await bus.close()
    assert reading.quality is Quality.GOOD
    assert reading.value == pytest.approx(0.002)
    assert await nc.read_compensation() == pytest.approx((1.0, -2.0, 3.0)), "its session is still open"
    await nc.close()

    site.folder.joinpath("password").write_text("wrong\n")
    stranger = make_bus("control", "opcua", fields)
    with pytest.raises(Refused, match=r"bus control: .* refuses user 'gateway'"):
        await stranger.connect()


async def test_nothing_readable_goes_over_the_wire(site: EncryptedSite) -> None:
    heard = bytearray()

    async def pass_on(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while data := await reader.read(65536):
            heard.extend(data)
            writer.write(data)
        writer.close()

    async def tap(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        port = int(site.url.rsplit(":", 1)[1])
        onward_reader, onward_writer = await asyncio.open_connection("127.0.0.1", port)
        await asyncio.gather(pass_on(reader, onward_writer), pass_on(onward_reader, writer))

    server = await asyncio.start_server(tap, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    nc = site.driver(url=f"opc.tcp://127.0.0.1:{port}")
    await nc.connect()
    await nc.request_probing(3)
    await nc.close()
    server.close()
    await server.wait_closed()
    assert len(heard) > 2000
    assert b"secret" not in heard
    assert b"actToolBasePos" not in heard


def test_the_command_makes_a_certificate_that_servers_accept_and_overwrites_none(tmp_path: Path) -> None:
    args = ["nc", "certificate", "-o", str(tmp_path), "--host", "mill-7"]
    made = CliRunner().invoke(main, args, catch_exceptions=False)
    certificate, key = map(Path, made.output.split())
    assert key.stat().st_mode & 0o777 == 0o600
    found = x509.load_der_x509_certificate(certificate.read_bytes())
    uses = found.extensions.get_extension_for_class(x509.KeyUsage).value
    assert all((uses.digital_signature, uses.content_commitment, uses.key_encipherment, uses.data_encipherment))
    assert not list(key_cautions(certificate, key))
    assert CliRunner().invoke(main, args).exit_code == 2


async def test_a_certificate_that_the_control_does_not_trust(site: EncryptedSite) -> None:
    stranger = make_pair(site.folder, "stranger", GATEWAY_URI)
    nc = site.driver(certificate=stranger.certificate, private_key=stranger.key)
    with pytest.raises(
        Refused, match=r"refuses the gateway's certificate .*BadCertificateUntrusted.*let the control trust"
    ):
        await nc.connect()


async def test_a_server_that_is_not_the_control(site: EncryptedSite) -> None:
    other = make_pair(site.folder, "other", APPLICATION_URI)
    nc = site.driver(server_certificate=other.certificate, timeout_s=1.0)
    with pytest.raises(DriverError, match="server_certificate"):
        await nc.connect()


async def test_a_wrong_password(site: EncryptedSite) -> None:
    with pytest.raises(Refused, match="refuses user 'gateway'"):
        await site.driver(password="guess").connect()


async def test_a_gateway_without_encryption(site: EncryptedSite) -> None:
    nc = site.driver(security="none")
    with pytest.raises(DriverError, match=r"Basic256Sha256"):
        await nc.connect()


async def test_a_policy_that_the_server_does_not_offer(site: EncryptedSite) -> None:
    open_to_all = EmulatedControl(Rigid(), RealClock(), LoadCase([DayPart(0.0, 1e9, Activity.PAUSE, MeanLoads())]))
    nc = site.driver(url=await open_to_all.start(), security="Aes128_Sha256_RsaOaep", server_certificate=None)
    with pytest.raises(Refused, match="offers no Aes128_Sha256_RsaOaep with SignAndEncrypt, but None None"):
        await nc.connect()
    await open_to_all.stop()


@pytest.mark.parametrize("which", ["certificate", "server_certificate"])
@pytest.mark.parametrize("days", [(-30, -1), (1, 30)])
async def test_a_certificate_out_of_its_time_is_reported_before_connecting(
    tmp_path: Path, which: str, days: tuple[float, float]
) -> None:
    good, bad = make_pair(tmp_path, "good", GATEWAY_URI), make_pair(tmp_path, "bad", GATEWAY_URI, days=days)
    files = {"certificate": good.certificate, "server_certificate": good.certificate} | {which: bad.certificate}
    settings = SinumerikSettings(
        url="opc.tcp://127.0.0.1:1",
        security="Basic256Sha256",
        certificate=files["certificate"],
        private_key=good.key,
        server_certificate=files["server_certificate"],
    )
    with pytest.raises(SetupError) as raised:
        await Sinumerik(settings, SystemClock()).connect()
    assert (raised.value.field, raised.value.what.code) == ((which,), "opcua_not_valid")
    assert raised.value.what.values["path"] == str(bad.certificate)


async def test_files_that_cannot_be_used_are_named(tmp_path: Path) -> None:
    good, nameless = make_pair(tmp_path, "good", GATEWAY_URI), make_pair(tmp_path, "nameless", None)
    rubbish, missing = tmp_path / "rubbish.pem", tmp_path / "missing.pem"
    rubbish.write_text("not a certificate")
    cases = [
        (missing, good.key, "certificate", "file_useless"),
        (rubbish, good.key, "certificate", "file_useless"),
        (nameless.certificate, nameless.key, "certificate", "opcua_no_uri"),
        (good.certificate, missing, "private_key", "file_useless"),
        (good.certificate, rubbish, "private_key", "file_useless"),
        (good.certificate, nameless.key, "private_key", "opcua_other_key"),
    ]
    for certificate, key, field, code in cases:
        settings = SinumerikSettings(
            url="opc.tcp://127.0.0.1:1",
            security="Basic256Sha256",
            certificate=certificate,
            private_key=key,
            server_certificate=good.certificate,
        )
        with pytest.raises(SetupError) as raised:
            await Sinumerik(settings, SystemClock()).connect()
        assert (raised.value.field, raised.value.what.code) == ((field,), code)
        assert raised.value.what.values["path"] == str(certificate if field == "certificate" else key)


@pytest.mark.parametrize("there", ["gateway.der", "gateway_key.pem"])
def test_beside_a_file_that_is_there_no_other_one_is_made(tmp_path: Path, there: str) -> None:
    (tmp_path / there).write_bytes(b"of before")
    with pytest.raises(FileExistsError):
        make_certificate(tmp_path, "mill-7")
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {there: b"of before"}
