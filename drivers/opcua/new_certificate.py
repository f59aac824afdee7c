"""Makes the gateway's own certificate for OPC UA servers, with all that they look for in one (Part 6, 6.2.2)."""

import errno
import os
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from drivers.opcua.certificates import LEAST_BITS

_LASTS = timedelta(days=3650)
_CLOCKS_DIFFER = timedelta(days=1)
_USE = x509.KeyUsage(
    digital_signature=True,
    content_commitment=True,
    key_encipherment=True,
    data_encipherment=True,
    key_cert_sign=True,  # it is its own authority
    key_agreement=False,
    crl_sign=False,
    encipher_only=False,
    decipher_only=False,
)


def make_certificate(folder: Path, host: str) -> tuple[Path, Path]:
    """Write `gateway.der`, signed by itself and valid for ten years, and its key `gateway_key.pem`, which only the user
    may read; returns both. host: name of this computer

    Raises FileExistsError for a file that is there, or another OSError.
    """
    certificate, private = folder / "gateway.der", folder / "gateway_key.pem"
    for path in (certificate, private):  # before either is written: half a pair would be in the way of the next one
        if path.exists():
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path))
    key = rsa.generate_private_key(public_exponent=65537, key_size=LEAST_BITS)
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, f"talc-gateway on {host}"[:64])])
    now, public = datetime.now(UTC), key.public_key()
    names = [x509.UniformResourceIdentifier(f"urn:{host}:talc-gateway"), x509.DNSName(host)]
    purposes = [ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH]
    made = (
        x509.CertificateBuilder(name, name, public, x509.random_serial_number(), now - _CLOCKS_DIFFER, now + _LASTS)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_USE, critical=True)
        .add_extension(x509.ExtendedKeyUsage(purposes), critical=False)
        .add_extension(x509.SubjectAlternativeName(names), critical=False)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(public), critical=False)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(public), critical=False)
        .sign(key, hashes.SHA256())
    )
    _write(private, key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()), 0o600)
    _write(certificate, made.public_bytes(Encoding.DER), 0o644)
    return certificate, private


def _write(path: Path, content: bytes, mode: int) -> None:
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as file:
        file.write(content)
