"""Files that a connection's settings name: passwords, tokens, and certificates of authorities."""

import grp
import stat
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Final

from drivers.base import SetupError
from drivers.bounded_file import bytes_of, check_bounds
from drivers.error_words import in_words
from drivers.text import Text

if TYPE_CHECKING:
    import ssl

ENDS_SOON: Final = timedelta(days=30)
"""A certificate that ends within this time is reported."""
SHARING_GROUP: Final = "talc-gateway"
"""The Debian package's group: the gateway, and the programs beside it, which connect to it with its own keys."""


def unusable_file(field: str, path: Path | None, error: Exception, device: str = "") -> SetupError:
    """The error that says why the file of a field cannot be used."""
    return SetupError(Text("file_useless", path=str(path), why=in_words(error)), field=(field,), device=device)


def secret_in(field: str, path: Path, device: str = "") -> str:
    """The file's text without the white space around it. Raises SetupError."""
    try:
        return bytes_of(path).decode().strip()
    except (OSError, UnicodeError) as error:
        raise unusable_file(field, path, error, device) from error


def trust_in(authority: Path | None) -> "ssl.SSLContext":
    """A client's TLS; None: with the authorities that the operating system trusts. Raises SetupError."""
    import ssl  # not for a certificate that is only looked at

    try:
        check_bounds(authority)
        return ssl.create_default_context(cafile=None if authority is None else str(authority))
    except (OSError, ValueError) as error:
        raise unusable_file("authority", authority, error) from error


def secret_cautions(path: Path) -> Iterator[str]:
    """Why this file with a secret is not as it should be."""
    try:
        found = path.stat()
    except OSError as error:
        yield f"'{path}' cannot be read: {error.strerror}"
    else:
        others = stat.S_IROTH if _group(found.st_gid) == SHARING_GROUP else stat.S_IRGRP | stat.S_IROTH
        if found.st_mode & others:
            yield f"'{path}' can be read by other users; chmod 600"


def _group(number: int) -> str:
    """Its name; empty if it has none."""
    try:
        return grp.getgrgid(number).gr_name
    except KeyError:
        return ""
