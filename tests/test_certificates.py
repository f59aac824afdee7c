"""deploy/zenoh: the authority's script makes what TLS and the configurations beside it need."""

import subprocess
from datetime import UTC, datetime, timedelta
from pathlib import Path
from shutil import which
from sys import executable

import pytest
from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from gateway.config.file import parse
from gateway.config.telemetry_rules import credential_problems, telemetry_problems
from tests.benches.service_file import TEXT

FOLDER = Path(__file__).parents[1] / "deploy" / "zenoh"


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["sh", str(FOLDER / "certificates.sh"), *arguments], capture_output=True, text=True)


@pytest.mark.peer
@pytest.mark.parametrize("name", ["gateway.toml", "gateway-without-router.toml"])
def test_what_the_script_issues_fits_the_configurations_beside_it(tmp_path: Path, name: str) -> None:
    assert which("openssl"), "Debian's package openssl"
    plant = tmp_path / "plant"
    for arguments in (
        ("authority", str(plant), "plant-authority"),
        ("issue", str(plant), "mill", "mill.plant.example,192.168.1.20,fd00::1", "30"),
    ):
        done = run(*arguments)
        assert done.returncode == 0, done.stderr
    issued = x509.load_pem_x509_certificate((plant / "mill.pem").read_bytes())
    authority = x509.load_pem_x509_certificate((plant / "authority.pem").read_bytes())
    issued.verify_directly_issued_by(authority)
    assert [a.value for a in issued.subject.get_attributes_for_oid(NameOID.COMMON_NAME)] == ["mill"]
    hosts = issued.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert hosts.get_values_for_type(x509.DNSName) == ["localhost", "mill.plant.example"]
    assert [str(a) for a in hosts.get_values_for_type(x509.IPAddress)] == ["127.0.0.1", "192.168.1.20", "fd00::1"]
    usage = issued.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
    assert {*usage} == {ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH}
    assert {path.name for path in plant.glob("*.key") if path.stat().st_mode & 0o077} == set()
    text = (FOLDER / name).read_text(encoding="utf-8").replace("/etc/talc-gateway/zenoh", str(plant))
    telemetry = parse(f"{TEXT}\n{text}", tmp_path / "gateway.toml").telemetry
    now = datetime.now(UTC)
    assert [*telemetry_problems(telemetry), *credential_problems(telemetry, now)] == []
    (late,) = credential_problems(telemetry, now + timedelta(days=31))
    assert "mill.pem' has expired" in str(late)


def rules(listed: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([executable, FOLDER / "router_rules.py", listed], capture_output=True, text=True)


def test_the_router_s_rules_are_those_of_the_list_beside_them() -> None:
    made = rules(FOLDER / "site.toml")
    assert (made.returncode, made.stdout) == (0, (FOLDER / "router.json5").read_text(encoding="utf-8"))


@pytest.mark.parametrize(
    ("listed", "said"),
    [
        ('machines = ["mill"]\nreaders = ["mill"]', "'mill' is already in machines"),
        ('machines = ["mill/**"]', "expected a list of names"),
        ('readers = ["anna"]', "machines: empty"),
        ('machines = ["mill"]\noperator = ["anna"]', "operator: unknown"),
    ],
)
def test_a_list_that_would_admit_others_than_meant_is_refused(tmp_path: Path, listed: str, said: str) -> None:
    (tmp_path / "site.toml").write_text(listed, encoding="utf-8")
    made = rules(tmp_path / "site.toml")
    assert (made.returncode, made.stdout) == (2, "")
    assert said in made.stderr


@pytest.mark.peer
def test_the_script_overwrites_no_authority_and_says_how_it_is_used(tmp_path: Path) -> None:
    plant = str(tmp_path / "plant")
    assert "no authority here" in run("issue", plant, "mill", "").stderr
    assert run("authority", plant, "plant").returncode == 0
    again = run("authority", plant, "plant")
    assert (again.returncode, "it is not overwritten" in again.stderr) == (1, True)
    assert "expected letters, digits" in run("issue", plant, "../mill", "").stderr
    assert "certificates.sh issue FOLDER NAME HOSTS" in run("issue").stderr
