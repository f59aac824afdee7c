"""Why no session opens to a place, by a connection and a TLS handshake of our own: Zenoh has one text for all."""

import socket
import ssl
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.bounded_file import check_bounds
from drivers.error_words import in_words
from gateway.config.telemetry import EndpointParts, endpoint
from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.telemetry.session import Access

if TYPE_CHECKING:
    from cryptography import x509

_CONNECT_S = 2.0
_ANSWER_S = 1.5
"""For the answer to a greeting; a refused certificate is told after the handshake of TLS 1.3."""
_BEGINS_LATER = 9
_HAS_EXPIRED = 10
_OTHER_HOST = (62, 64)
"""X509_V_ERR_CERT_NOT_YET_VALID, _CERT_HAS_EXPIRED, _HOSTNAME_MISMATCH and _IP_ADDRESS_MISMATCH of OpenSSL."""
_STREAMS = ("tcp", "tls")


def why_not(places: Sequence[str], access: Access, otherwise: str = "") -> Text:
    """Why no session opens to any of these endpoints: of each the cause, the first that is found. Blocks for seconds.

    otherwise: what Zenoh says, for a cause that is not found
    """
    unknown = Text(NoticeCode.PLACE_OTHER, place=", ".join(places), error=otherwise and f": {otherwise}")
    found = (cause(endpoint(text), access) for text in places)
    return next((text for text in found if text is not None), unknown)


def cause(place: EndpointParts, access: Access) -> Text | None:
    """Why no session opens to this place; None: nothing is found. Blocks for seconds."""
    if place.protocol not in _STREAMS:
        return None
    try:
        with socket.create_connection((place.host, place.port), _CONNECT_S) as line:
            line.settimeout(_ANSWER_S)
            return _of_tls(line, place, access) if place.encrypted else _of_plain(line, place)
    except socket.gaierror as error:
        return Text(NoticeCode.PLACE_NAME_UNKNOWN, place=place.text, host=place.host, error=in_words(error))
    except ConnectionRefusedError:
        return Text(NoticeCode.PLACE_CLOSED, place=place.text)
    except OSError as error:
        return Text(NoticeCode.PLACE_SILENT, place=place.text, error=in_words(error))


def _of_plain(line: socket.socket, place: EndpointParts) -> Text | None:
    context = _trusting_all()
    try:
        context.wrap_socket(line, server_hostname=place.host).close()
    except (ssl.SSLError, OSError):
        return None
    return Text(NoticeCode.PLACE_ENCRYPTED, place=place.text)


def _of_tls(line: socket.socket, place: EndpointParts, access: Access) -> Text | None:
    try:
        context = _as_configured(access)
    except ssl.SSLError as error:
        files = ", ".join(str(path) for path in (access.authority, access.certificate, access.key) if path is not None)
        if error.reason == "KEY_VALUES_MISMATCH":
            return Text(NoticeCode.TLS_KEY_APART, key=str(access.key), certificate=str(access.certificate))
        return Text(NoticeCode.TLS_FILE, path=files, error=error.reason or str(error))
    except OSError as error:
        return Text(NoticeCode.TLS_FILE, path=_unread(access), error=in_words(error))
    try:
        with context.wrap_socket(line, server_hostname=place.host) as secured, suppress(TimeoutError):
            if not secured.recv(1):
                return Text(NoticeCode.TLS_CLOSED, place=place.text)
    except ssl.SSLCertVerificationError as error:
        return _unproved(error, place, access)
    except ssl.SSLError as error:
        return _refused(error, place, access)
    except OSError as error:
        return Text(NoticeCode.PLACE_PLAIN, place=place.text, error=in_words(error))
    return None


def _as_configured(access: Access) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    if access.authority is not None:
        context.load_verify_locations(access.authority)
    if access.certificate is not None and access.key is not None:
        context.load_cert_chain(access.certificate, access.key)
    return context


def _trusting_all() -> ssl.SSLContext:
    """To look at what is there; nothing is sent over it."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    return context


def _unread(access: Access) -> str:
    """The first of the files that cannot be read."""
    for path in (access.authority, access.certificate, access.key):
        try:
            if path is not None:
                check_bounds(path)
        except OSError:
            return str(path)
    return ""


def _unproved(error: ssl.SSLCertVerificationError, place: EndpointParts, access: Access) -> Text:
    """Why the other side's certificate proves nothing."""
    shown, now = _shown_by(place), datetime.now(UTC)
    if error.verify_code == _BEGINS_LATER and shown is not None:
        return Text(NoticeCode.TLS_NOT_YET, place=place.text, begins=shown.not_valid_before_utc, now=now)
    if error.verify_code == _HAS_EXPIRED and shown is not None:
        return Text(NoticeCode.TLS_EXPIRED, place=place.text, ends=shown.not_valid_after_utc, now=now)
    if error.verify_code in _OTHER_HOST:
        names = ", ".join(_names(shown)) or "-"
        return Text(NoticeCode.TLS_OTHER_HOST, place=place.text, host=place.host, names=names)
    return Text(
        NoticeCode.TLS_OTHER_AUTHORITY, place=place.text, authority=str(access.authority), error=error.verify_message
    )


def _refused(error: ssl.SSLError, place: EndpointParts, access: Access) -> Text:
    """What the other side does not accept, by its alert."""
    reason = error.reason or str(error)
    if "ALERT" not in reason:
        return Text(NoticeCode.PLACE_PLAIN, place=place.text, error=reason)
    if access.certificate is None or "CERTIFICATE_REQUIRED" in reason:
        return Text(NoticeCode.TLS_CERTIFICATE_WANTED, place=place.text)
    ends = _end(access.certificate)
    if "EXPIRED" in reason and ends is not None:
        return Text(NoticeCode.TLS_OWN_EXPIRED, place=place.text, path=str(access.certificate), ends=ends)
    return Text(NoticeCode.TLS_OWN_REFUSED, place=place.text, path=str(access.certificate), error=reason)


def _shown_by(place: EndpointParts) -> "x509.Certificate | None":
    """The certificate that is shown there, whatever it is worth."""
    from cryptography import x509  # only here: it takes long to load

    try:
        with (
            socket.create_connection((place.host, place.port), _CONNECT_S) as line,
            _trusting_all().wrap_socket(line, server_hostname=place.host) as secured,
        ):
            found = secured.getpeercert(binary_form=True)
    except OSError:
        return None
    return None if found is None else x509.load_der_x509_certificate(found)


def _names(certificate: "x509.Certificate | None") -> list[str]:
    from cryptography import x509

    if certificate is None:
        return []
    try:
        found = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except (x509.ExtensionNotFound, ValueError):
        return []
    return [str(name.value) for name in found]


def _end(path: Path) -> datetime | None:
    from gateway.config.certificates import certificate_end

    return certificate_end(path)
