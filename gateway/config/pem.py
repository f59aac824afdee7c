"""Files of certificates and private keys."""

from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.types import PublicKeyTypes
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat, load_pem_private_key

from drivers.bounded_file import bytes_of
from gateway.model.codes import NoticeCode
from gateway.model.text import Text


def certificates(path: Path) -> list[x509.Certificate]:
    """The certificates of a PEM file, at least one. Raises OSError, ValueError."""
    try:
        return x509.load_pem_x509_certificates(bytes_of(path))
    except ValueError:
        raise ValueError(Text(NoticeCode.NO_PEM)) from None


def public_key(path: Path) -> bytes:
    """The public key of a private key in PEM. Raises OSError, ValueError."""
    try:
        key = load_pem_private_key(bytes_of(path), None)
    except (ValueError, TypeError):  # TypeError: it needs a password, which nobody gives when the gateway starts
        raise ValueError(Text(NoticeCode.NO_PEM_KEY)) from None
    return der(key.public_key())


def der(key: PublicKeyTypes) -> bytes:
    """A public key in one form, so that two can be compared."""
    return key.public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)
