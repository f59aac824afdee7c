"""Certificates and keys of an OPC UA connection: whether they can be used, and what they say."""

from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.hazmat.primitives.serialization import load_der_private_key, load_pem_private_key

from drivers.base import SetupError
from drivers.credential_files import ENDS_SOON, unusable_file

LEAST_BITS = 2048
"""Smallest size of RSA keys (OPC UA Part 7, Basic256Sha256)."""
MOST_BITS = 4096
"""Largest size of RSA keys."""


def valid_certificate(path: Path | None, name: str, device: str) -> x509.Certificate:
    """The certificate in a file. Raises SetupError unless it is one and is valid at present."""
    try:
        content = path.read_bytes() if path is not None else b""
        pem = content.startswith(b"-----BEGIN")
        certificate = x509.load_pem_x509_certificate(content) if pem else x509.load_der_x509_certificate(content)
    except (OSError, ValueError) as error:
        raise unusable_file(name, path, error, device) from error
    begin, end = certificate.not_valid_before_utc, certificate.not_valid_after_utc
    if not begin <= datetime.now(UTC) <= end:
        raise SetupError(
            f"{name} = {str(path)!r} is valid from {begin:%Y-%m-%d %H:%M} to {end:%Y-%m-%d %H:%M} UTC, not now",
            device=device,
            hint="renew it; if it is new, check this computer's clock",
        )
    return certificate


def check_key(certificate: x509.Certificate, path: Path | None, device: str) -> None:
    """Raises SetupError unless the file holds the certificate's key, and Basic256Sha256 takes it (Part 7: RSA)."""
    try:
        content = path.read_bytes() if path is not None else b""
        read = load_pem_private_key if content.startswith(b"-----BEGIN") else load_der_private_key
        key = read(content, None)
    except (OSError, ValueError, TypeError, UnsupportedAlgorithm) as error:
        raise unusable_file("private_key", path, error, device) from error
    if not isinstance(key, rsa.RSAPrivateKey) or not LEAST_BITS <= key.key_size <= MOST_BITS:
        found = f"RSA of {key.key_size} bits" if isinstance(key, rsa.RSAPrivateKey) else "no RSA key"
        raise SetupError(
            f"private_key = {str(path)!r} is {found}: Basic256Sha256 takes RSA of {LEAST_BITS} to {MOST_BITS} bits",
            device=device,
            hint="make a new key and a certificate with it",
        )
    if key.public_key() != certificate.public_key():
        raise SetupError(
            f"private_key = {str(path)!r} is the key of another certificate",
            device=device,
            hint="certificate and private_key are made together",
        )


def application_uri(certificate: x509.Certificate, path: Path | None, device: str) -> str:
    """The certificate's application URI; servers compare it with the one that we send (Part 6, 6.2.2)."""
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        uris = []
    else:
        uris = names.get_values_for_type(x509.UniformResourceIdentifier)
    if not uris:
        raise SetupError(f"certificate = {str(path)!r} holds no application URI as alternative name", device=device)
    return uris[0]


def certificate_cautions(path: Path, name: str) -> Iterator[str]:
    """Why this certificate cannot be used, or that it ends soon."""
    try:
        end = valid_certificate(path, name, "").not_valid_after_utc
    except SetupError as error:
        yield error.what
    else:
        if end - datetime.now(UTC) < ENDS_SOON:
            yield f"'{path}' expires on {end:%Y-%m-%d}; renew it before then, or no connection is possible"


def key_cautions(path: Path | None, key: Path | None) -> Iterator[str]:
    """Why this key cannot be used with its certificate; nothing if the certificate itself cannot be used."""
    try:
        certificate = valid_certificate(path, "certificate", "")
    except SetupError:
        return
    try:
        check_key(certificate, key, "")
    except SetupError as error:
        yield error.what
