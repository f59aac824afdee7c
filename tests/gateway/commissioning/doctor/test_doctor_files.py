"""What `doctor` says of a file with a key, a certificate or passwords that can be read and is of no use."""

from pathlib import Path

import pytest

from gateway.commissioning.doctor.health import health_findings
from gateway.config.file import load
from tests.benches.plant_authority import DAY, PlantAuthority

TEXT = """
[machine]
name = "mill"
[storage]
warn_free_mb = 0.0
[[bus]]
name = "rtu1"
kind = "modbus_rtu"
port = "line"
[[device]]
name = "rtd1"
bus = "rtu1"
profile = "icpdas_m7015"
channels = { bed = 0 }
"""
HEARD = "no other computer receives anything from the gateway"
RENEW = "renew the file, or set the clock of this computer if it is wrong (docs/site.md)"


@pytest.mark.parametrize(
    ("section", "field", "holds", "why", "remedy"),
    [
        ('[[telemetry.operator]]\nname = "anna"\nkey_file = "WORD"\nmay = ["pause"]',
         "[[telemetry.operator]] 'anna', key_file", "short", "every command of 'anna' is refused",
         "make a new key: openssl rand -hex 32 > 'WORD'; its owner needs the same one (docs/commands.md)"),
        ('[telemetry]\nusers_file = "WORD"', "[telemetry] users_file", "anna:a\nbob\n", HEARD,
         "correct the file: expected a line user:password for each user (docs/site.md)"),
        ('[telemetry]\nusers_file = "WORD"', "[telemetry] users_file", "", HEARD,
         "correct the file: expected a line user:password for each user (docs/site.md)"),
        ('[telemetry]\nuser = "anna"\npassword_file = "WORD"\nconnect = ["tcp/127.0.0.1:7447"]',
         "[telemetry] password_file", "\n", HEARD, "write the password into the file (docs/site.md)"),
        ('[telemetry.tls]\ncertificate = "MILL.pem"\nkey = "WORD"', "[telemetry.tls] key", "no key", HEARD,
         "copy the key that belongs to the certificate, or make both again (docs/site.md)"),
        ('[telemetry.tls]\ncertificate = "OLD.pem"\nkey = "OLD.key"', "[telemetry.tls] certificate", "", HEARD, RENEW),
        ('[telemetry.tls]\nauthority = "OLD.pem"', "[telemetry.tls] authority", "", HEARD, RENEW),
    ],
    ids=["operator", "line of users", "no user", "password", "key", "certificate", "authority"],
)  # fmt: skip
def test_for_a_file_of_no_use_it_says_what_does_not_work_and_what_to_do(
    section: str, field: str, holds: str, why: str, remedy: str, tmp_path: Path
) -> None:
    word, plant = tmp_path / "line 5", PlantAuthority(tmp_path / "plant")
    word.write_text(holds, encoding="utf-8")
    word.chmod(0o600)
    for name, (certificate, key) in {"MILL": plant.issue("mill"), "OLD": plant.issue("old", -DAY)}.items():
        section = section.replace(f"{name}.pem", str(certificate)).replace(f"{name}.key", str(key))
    (tmp_path / "gateway.toml").write_text(TEXT + section.replace("WORD", str(word)), encoding="utf-8")
    (ailment,) = health_findings(load(tmp_path / "gateway.toml"), tmp_path / "root", synchronised=True)
    assert ailment.what.startswith(f"{field}: '{tmp_path}/")
    assert (ailment.why, ailment.remedy) == (why, remedy.replace("WORD", str(word)))
