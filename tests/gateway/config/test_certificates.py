"""When the certificates that a configuration names expire."""

import ssl
from datetime import UTC, datetime, timedelta
from pathlib import Path

from gateway.config.certificates import certificate_end, certificate_ends
from tests.benches.plant_authority import DAY, PlantAuthority
from tests.benches.service_file import two_temperatures


def test_each_certificate_of_the_configuration_is_named_and_one_that_cannot_be_read_is_left_out(tmp_path: Path) -> None:
    authority = PlantAuthority(tmp_path)
    certificate, key = authority.issue("gateway", 20 * DAY)
    own, secret = authority.issue("client", 5 * DAY)
    own_key = secret.rename(tmp_path / "client-key.pem")
    broken = tmp_path / "server.pem"
    broken.write_text("no certificate", encoding="utf-8")
    telemetry = {
        "listen": ["tls/127.0.0.1:7447"],
        "tls": {"certificate": str(certificate), "key": str(key)},
    }
    nc = {
        "kind": "sinumerik",
        "url": "opc.tcp://192.168.214.1:4840",
        "security": "Basic256Sha256",
        "certificate": str(own),
        "private_key": str(own_key),
        "server_certificate": str(broken),
    }
    config = two_temperatures(tmp_path / "g.sqlite", {"telemetry": telemetry, "nc": nc})
    found = certificate_ends(config)
    assert list(found) == ["[telemetry.tls] certificate", "[nc] certificate"]
    now = datetime.now(UTC)
    left = [ends - now for ends in found.values()]
    hour = timedelta(hours=1)
    assert 20 * DAY - hour < left[0] <= 20 * DAY
    assert 5 * DAY - hour < left[1] <= 5 * DAY
    without = nc | {"security": "none"}
    config = two_temperatures(tmp_path / "g.sqlite", {"telemetry": telemetry, "nc": without})
    assert list(certificate_ends(config)) == ["[telemetry.tls] certificate"], "the other one is not used"


def test_of_several_certificates_in_a_file_the_first_to_expire_counts_and_der_is_read_too(tmp_path: Path) -> None:
    authority = PlantAuthority(tmp_path)
    (late, _), (early, _) = authority.issue("late", 50 * DAY), authority.issue("early", 3 * DAY)
    both = tmp_path / "both.pem"
    both.write_bytes(late.read_bytes() + early.read_bytes())
    assert certificate_end(both) == certificate_end(early)
    der = tmp_path / "late.der"
    der.write_bytes(ssl.PEM_cert_to_DER_cert(late.read_text(encoding="ascii")))
    assert certificate_end(der) == certificate_end(late)
    assert certificate_end(tmp_path / "none.pem") is None
