"""Certificates and keys of an OPC UA connection: whether they can be used, and what they say."""

from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.hazmat.primitives.serialization import load_der_private_key, load_pem_private_key

from drivers.base import SetupError
from drivers.bounded_file import bytes_of
from drivers.credential_files import ENDS_SOON, unusable_file
from drivers.text import Text

LEAST_BITS = 2048
"""Smallest size of RSA keys (OPC UA Part 7, Basic256Sha256)."""
MOST_BITS = 4096
"""Largest size of RSA keys."""


def valid_certificate(path: Path | None, name: str, device: str) -> x509.Certificate:
    """The certificate in a file. Raises SetupError unless it is one and is valid at present."""
    try:
        content = bytes_of(path) if path is not None else b""
        pem = content.startswith(b"-----BEGIN")
        certificate = x509.load_pem_x509_certificate(content) if pem else x509.load_der_x509_certificate(content)
    except (OSError, ValueError) as error:
        raise unusable_file(name, path, error, device) from error
    begin, end = certificate.not_valid_before_utc, certificate.not_valid_after_utc
    if not begin <= datetime.now(UTC) <= end:
        raise SetupError(
            Text("opcua_not_valid", path=str(path), begin=begin, end=end),
            field=(name,),
            device=device,
            hint=Text("opcua_renew"),
        )
    return certificate


def check_key(certificate: x509.Certificate, path: Path | None, device: str) -> None:
    """Raises SetupError unless the file holds the certificate's key, and Basic256Sha256 takes it (Part 7: RSA)."""
    try:
        content = bytes_of(path) if path is not None else b""
        read = load_pem_private_key if content.startswith(b"-----BEGIN") else load_der_private_key
        key = read(content, None)
    except (OSError, ValueError, TypeError, UnsupportedAlgorithm) as error:
        raise unusable_file("private_key", path, error, device) from error
    bits = key.key_size if isinstance(key, rsa.RSAPrivateKey) else 0
    if not LEAST_BITS <= bits <= MOST_BITS:
        what = Text("opcua_no_rsa", path=str(path), least=LEAST_BITS, most=MOST_BITS)
        if bits:
            what = Text("opcua_key_size", path=str(path), bits=bits, least=LEAST_BITS, most=MOST_BITS)
        raise SetupError(what, field=("private_key",), device=device, hint=Text("opcua_new_key"))
    if key.public_key() != certificate.public_key():
        raise SetupError(
            Text("opcua_other_key", path=str(path)),
            field=("private_key",),
            device=device,
            hint=Text("opcua_made_together"),
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
        raise SetupError(Text("opcua_no_uri", path=str(path)), field=("certificate",), device=device)
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
