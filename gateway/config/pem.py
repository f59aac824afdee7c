"""Files of certificates and private keys."""

from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.types import PublicKeyTypes
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat, load_pem_private_key


def certificates(path: Path) -> list[x509.Certificate]:
    """The certificates of a PEM file, at least one. Raises OSError, ValueError."""
    try:
        return x509.load_pem_x509_certificates(path.read_bytes())
    except ValueError:
        raise ValueError("expected certificates in PEM, beginning with -----BEGIN CERTIFICATE-----") from None


def public_key(path: Path) -> bytes:
    """The public key of a private key in PEM. Raises OSError, ValueError."""
    try:
        key = load_pem_private_key(path.read_bytes(), None)
    except (ValueError, TypeError):  # TypeError: it needs a password, which nobody gives when the gateway starts
        raise ValueError("expected a private key in PEM without a password") from None
    return der(key.public_key())


def der(key: PublicKeyTypes) -> bytes:
    """A public key in one form, so that two can be compared."""
    return key.public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)
