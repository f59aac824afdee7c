"""`[nc]`: the file's settings reach the driver, and unsafe ones cause a warning."""

from datetime import UTC, datetime, timedelta
from functools import cache
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec, rsa
from cryptography.x509.oid import NameOID

from drivers.sinumerik.settings import Handshake, LeaseParameters, OffsetRoute, SinumerikSettings, StateNode
from gateway.config.controls import LinuxCncNc, SinumerikNc
from gateway.config.file import parse
from gateway.config.model import GatewayConfig
from gateway.config.problems import ConfigError
from gateway.config.rules import cautions
from gateway.control.planned_loads import rows_remembered
from gateway.model.text import Text, plain
from talc.steps import DAY_S, steps_in
from tests.benches.one_device import ONE_DEVICE

SECURE = """
[nc]
kind = "sinumerik"
url = "opc.tcp://192.168.214.1:4840"
user = "gateway"
password_file = "password"
certificate = "gateway.pem"
private_key = "gateway_key.pem"
"""
EVERYTHING = """
[probing]
poses_deg = [[0, 0], [0, 72], [0, 144], [0, 216], [0, 288], [90, 0], [-90, 0]]
[[state]]
name = "speed_C"
[[state]]
name = "coolant"

[nc]
kind = "sinumerik"
url = "opc.tcp://192.168.214.1:4850"
security = "Basic256Sha256"
user = "gateway"
password_file = "secret/password"
certificate = "gateway.der"
private_key = "/srv/talc/gateway_key.pem"
server_certificate = "control.der"
namespace_uri = "urn:some:control"
timeout_s = 1.5
subscribe_s = 0.25
axis_numbers = {X = 3, Y = 2, Z = 1, A = 6, C = 5}
origin_mm = [400.0, 0, -120.5]
[nc.nodes]
position = "/Channel/MachineAxis/measPos1[u2,{n}]"
r_parameter = "/Channel/Parameter/R[u2,{n}]"
k0 = "/NC/a[u{n}]"
slope = "/NC/b[u{n}]"
reference = "/NC/c[u{n}]"
mode = ""
program = "/Channel/State/progStatus[u2]"
tool = "/Plc/DB21.DBW4:INT"
probe_in_spindle = "/Plc/DB21.DBX0.1"
alarms = ["/Nck/SequencedAlarms/textIndex[1]"]
[nc.states.coolant]
path = "/Plc/Q4.0"
[nc.states.speed_C]
path = "/Channel/Parameter/R[u2,40]"
[nc.handshake]
request = 160
withdraw = 161
valid_for = 162
answers = 163
state = 164
reason = 165
result_of = 166
results = 170
request_valid_for_s = 600.0
[nc.lease]
owner = 193
beat = 194
silence = 195
state = 196
ramp = 197
[nc.compensation]
route = "r"
signs = [1, -1, 1]
first_r = 200
largest_um = 80.0
"""


def config(text: str, folder: Path = Path("/srv/talc")) -> GatewayConfig:
    return parse(ONE_DEVICE + text, folder / "gateway.toml")


def driver_settings(config: GatewayConfig) -> SinumerikSettings:
    assert isinstance(config.nc, SinumerikNc)
    return config.nc.settings(config.probing.poses_deg, [state.name for state in config.states])


def test_every_key_reaches_the_driver() -> None:
    settings = driver_settings(config(EVERYTHING))
    assert settings.url == "opc.tcp://192.168.214.1:4850"
    assert (settings.security, settings.user) == ("Basic256Sha256", "gateway")
    assert settings.password_file == Path("/srv/talc/secret/password")
    assert settings.certificate == Path("/srv/talc/gateway.der")
    assert settings.private_key == Path("/srv/talc/gateway_key.pem")
    assert settings.server_certificate == Path("/srv/talc/control.der")
    assert settings.namespace_uri == "urn:some:control"
    assert (settings.timeout_s, settings.subscribe_s) == (1.5, 0.25)
    assert settings.axis_numbers == {"X": 3, "Y": 2, "Z": 1, "A": 6, "C": 5}
    assert settings.origin_mm == (400.0, 0.0, -120.5)
    paths = settings.nodes
    assert (paths.k0, paths.slope, paths.reference) == ("/NC/a[u{n}]", "/NC/b[u{n}]", "/NC/c[u{n}]")
    assert paths.position == "/Channel/MachineAxis/measPos1[u2,{n}]"
    assert (paths.mode, paths.program) == ("", "/Channel/State/progStatus[u2]")
    assert (paths.tool, paths.probe_in_spindle) == ("/Plc/DB21.DBW4:INT", "/Plc/DB21.DBX0.1")
    assert paths.alarms == ("/Nck/SequencedAlarms/textIndex[1]",)
    assert settings.r(160) == "/Channel/Parameter/R[u2,160]"
    assert settings.poses == 7
    assert settings.state_sources == {
        "speed_C": StateNode(path="/Channel/Parameter/R[u2,40]", divisor=1.0),
        "coolant": StateNode(path="/Plc/Q4.0"),
    }
    assert settings.handshake == Handshake(
        request=160, withdraw=161, valid_for=162, answers=163, state=164, reason=165, result_of=166, results=170,
        request_valid_for_s=600.0,
    )  # fmt: skip
    assert settings.lease == LeaseParameters(owner=193, beat=194, silence=195, state=196, ramp=197)
    assert settings.compensation == OffsetRoute(route="r", signs=(1, -1, 1), first_r=200, largest_um=80.0)


def test_what_is_left_out_is_as_the_driver_has_it() -> None:
    found = driver_settings(config(SECURE))
    usual = SinumerikSettings(security="none", url="opc.tcp://nc")
    assert found.security == "Basic256Sha256"
    assert (found.nodes, found.handshake, found.lease) == (usual.nodes, usual.handshake, usual.lease)
    assert (found.compensation, found.axis_numbers) == (usual.compensation, usual.axis_numbers)
    assert found.namespace_uri == usual.namespace_uri
    assert found.state_sources == {}, "nothing is read that nobody uses"


@cache
def key_of(bits: int, number: int = 0) -> rsa.RSAPrivateKey:
    """Made once: it takes its time."""
    del number
    return rsa.generate_private_key(public_exponent=65537, key_size=bits)


def write_key(folder: Path, key: rsa.RSAPrivateKey | ec.EllipticCurvePrivateKey) -> None:
    pkcs8, plain = serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    (folder / "gateway_key.pem").write_bytes(key.private_bytes(serialization.Encoding.PEM, pkcs8, plain))


def write_files(folder: Path, *, days: float, mode: int = 0o600, bits: int = 2048) -> None:
    key = key_of(bits)
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "gateway")])
    now = datetime.now(UTC)
    builder = x509.CertificateBuilder().subject_name(name).issuer_name(name).public_key(key.public_key())
    builder = builder.serial_number(1).not_valid_before(now - timedelta(days=400))
    certificate = builder.not_valid_after(now + timedelta(days=days)).sign(key, hashes.SHA256())
    for file in ("gateway.pem", "control.pem"):
        (folder / file).write_bytes(certificate.public_bytes(serialization.Encoding.PEM))
    (folder / "password").write_text("secret")
    write_key(folder, key)
    for file in ("password", "gateway_key.pem"):
        (folder / file).chmod(mode)


def told(config: GatewayConfig) -> dict[str, Text]:
    return {caution.where: plain(caution.what) for caution in cautions(config)}


def test_a_sound_setup_gives_no_caution(tmp_path: Path) -> None:
    write_files(tmp_path, days=365)
    assert told(config(SECURE + 'server_certificate = "control.pem"\n', tmp_path)) == {}


@pytest.mark.parametrize(("days", "said"), [(-1, "is valid from"), (29, "expires on")])
def test_a_certificate_that_has_ended_or_soon_will_is_a_caution(tmp_path: Path, days: float, said: str) -> None:
    write_files(tmp_path, days=days)
    found = told(config(SECURE + 'server_certificate = "control.pem"\n', tmp_path))
    assert set(found) == {"[nc] certificate", "[nc] server_certificate"}
    assert all(said in text for text in found.values())


def test_secrets_that_others_can_read_and_files_that_are_missing_are_cautions(tmp_path: Path) -> None:
    write_files(tmp_path, days=365, mode=0o640)
    found = told(config(SECURE + 'server_certificate = "elsewhere.pem"\n', tmp_path))
    assert set(found) == {"[nc] password_file", "[nc] private_key", "[nc] server_certificate"}
    assert "chmod 600" in found["[nc] password_file"]
    assert "No such file" in found["[nc] server_certificate"]


def test_a_key_of_another_certificate_or_a_weak_one_is_a_caution(tmp_path: Path) -> None:
    text = SECURE + 'server_certificate = "control.pem"\n'
    write_files(tmp_path, days=365)
    write_key(tmp_path, key_of(2048, 1))
    assert told(config(text, tmp_path))["[nc] private_key"].says("opcua_other_key")
    write_key(tmp_path, ec.generate_private_key(ec.SECP256R1()))
    assert told(config(text, tmp_path))["[nc] private_key"].says("opcua_no_rsa")
    write_files(tmp_path, days=365, bits=1024)
    weak = told(config(text, tmp_path))["[nc] private_key"]
    assert (weak.code, weak.values["bits"]) == ("opcua_key_size", 1024)


def test_trusting_any_server_gives_a_caution(tmp_path: Path) -> None:
    write_files(tmp_path, days=365)
    assert set(told(config(SECURE, tmp_path))) == {"[nc] server_certificate"}


@pytest.mark.parametrize(
    ("host", "where"),
    [("192.168.214.1", ["[nc] security"]), ("mill", ["[nc] security"]), ("127.0.0.1", []), ("localhost", [])],
)
def test_no_encryption_beyond_this_computer_gives_a_caution(host: str, where: list[str]) -> None:
    text = f'[nc]\nkind = "sinumerik"\nurl = "opc.tcp://{host}:4840"\nsecurity = "none"\n'
    assert list(told(config(text))) == where


COMPENSATE = '[compensation]\nmode = "compensate"\n'


@pytest.mark.parametrize(
    ("more", "speed"),
    [
        pytest.param(COMPENSATE, "600", id="k0"),
        pytest.param(COMPENSATE + "slew_um_per_s = 5.0\n", "3000", id="a faster slew"),
        pytest.param('[nc.compensation]\nroute = "r"\n' + COMPENSATE, "600", id="r"),
        pytest.param("", None, id="nothing is written"),
        pytest.param(
            '[nc.compensation]\nroute = "k0_slope"\ntravel_mm = [[-1, 1], [-1, 1], [-1, 1]]\n' + COMPENSATE,
            None,
            id="k0_slope",
        ),
    ],
)
def test_offsets_that_the_axes_outrun_are_a_caution(more: str, speed: str | None) -> None:
    text = '[nc]\nkind = "sinumerik"\nurl = "opc.tcp://127.0.0.1:4840"\nsecurity = "none"\n' + more
    said = told(config(text)).get("[nc.compensation] route")
    assert (said is not None) == (speed is not None)
    if said is not None:
        assert f"an axis faster than {speed} mm/min outruns them" in said


def test_linuxcnc_gets_its_settings_and_its_cautions(tmp_path: Path) -> None:
    (tmp_path / "talc.key").write_text("k" * 64)
    (tmp_path / "talc.key").chmod(0o640)
    text = '[nc]\nkind = "linuxcnc"\nhost = "192.168.0.20"\nport = 7700\nkey_file = "talc.key"\n'
    states = '[[state]]\nname = "speed_C"\n'
    made = config(states + text, tmp_path)
    assert isinstance(made.nc, LinuxCncNc)
    settings = made.nc.settings(made.probing.poses_deg, ["speed_C"])
    assert (settings.host, settings.port, settings.key()) == ("192.168.0.20", 7700, b"k" * 64)
    told = [str(problem) for problem in cautions(made)]
    assert any("is another computer" in line for line in told)
    assert any("can be read by other users" in line for line in told)
    with pytest.raises(
        ConfigError,
        match=r"state 'door': not every control provides it; possible: analog_output_0, .*, coolant, speed_A, ",
    ):
        config('[[state]]\nname = "door"\n' + text, tmp_path)


def test_planned_loads_are_of_inputs_that_there_are(tmp_path: Path) -> None:
    (tmp_path / "talc.key").write_text("k" * 64)
    nc = '[nc]\nkind = "linuxcnc"\nhost = "127.0.0.1"\nport = 7700\nkey_file = "talc.key"\n'
    states = '[[state]]\nname = "spindle_speed"\n'
    planned = '[[planned_load]]\nname = "warm-up"\nloads = {spindle_speed = 6000.0}\n'
    made = config(states + planned + nc, tmp_path)
    assert {each.name: dict(each.loads) for each in made.planned_loads} == {"warm-up": {"spindle_speed": 6000.0}}
    for text, said in (
        (planned.replace("spindle_speed", "spindle_sped"), "planned_load 'warm-up', loads.spindle_sped: not an input"),
        (planned + planned, "planned_load 'warm-up': name is used 2 times"),
        (planned.replace("spindle_speed = 6000.0", ""), "expected at least one load"),
        (planned + '[talc]\nmethod = "models"\n', r"\[\[planned_load\]\]: works only with"),
    ):
        with pytest.raises(ConfigError, match=said):
            config(states + text + nc, tmp_path)


@pytest.mark.parametrize("step_s", [4.3, 4.2])
def test_check_says_when_the_grid_step_is_too_short_for_planned_loads(step_s: float, tmp_path: Path) -> None:
    (tmp_path / "talc.key").write_text("k" * 64)
    nc = '[nc]\nkind = "linuxcnc"\nhost = "127.0.0.1"\nport = 7700\nkey_file = "talc.key"\n'
    planned = '[[planned_load]]\nname = "warm-up"\nloads = {spindle_speed = 6000.0}\n'
    made = config(f'[[state]]\nname = "spindle_speed"\n[grid]\nstep_s = {step_s}\n' + planned + nc, tmp_path)
    short = "[[planned_load]]: has no effect with [grid] step_s below 4.3" in map(str, cautions(made))
    assert short == (step_s < 4.3)
    assert short == (rows_remembered(step_s) < steps_in(2.0 * DAY_S, step_s)), "less than learning needs is kept"
