"""Password hashes: scrypt, as `scrypt$n$r$p$salt$hash` with the last two in Base64."""

import hashlib
import hmac
import os
from base64 import b64decode, b64encode
from binascii import Error as NotBase64

_N, _R, _P = 2**14, 8, 1
"""16 MB and some 50 ms for each attempt (RFC 7914)."""
_MOST_BYTES = 64 * 2**20
_SALT, _LENGTH = 16, 32


def make_hash(password: str) -> str:
    """The hash of a password, with a salt of its own."""
    salt = os.urandom(_SALT)
    return _text(salt, _hashed(password, salt, _N, _R, _P))


def is_hash(text: str) -> bool:
    """Whether it is one that `matches` can check."""
    return _parts(text) is not None


def matches(password: str, text: str) -> bool:
    """Whether this is the password of the hash."""
    parts = _parts(text)
    if parts is None:
        return False
    n, r, p, salt, wanted = parts
    return hmac.compare_digest(_hashed(password, salt, n, r, p), wanted)


def _hashed(password: str, salt: bytes, n: int, r: int, p: int) -> bytes:
    return hashlib.scrypt(password.encode(), salt=salt, n=n, r=r, p=p, maxmem=_MOST_BYTES, dklen=_LENGTH)


def _text(salt: bytes, digest: bytes) -> str:
    return "$".join(("scrypt", str(_N), str(_R), str(_P), b64encode(salt).decode(), b64encode(digest).decode()))


def _parts(text: str) -> tuple[int, int, int, bytes, bytes] | None:
    try:
        scheme, n, r, p, salt, digest = text.split("$")
        found = int(n), int(r), int(p), b64decode(salt, validate=True), b64decode(digest, validate=True)
    except (ValueError, NotBase64):
        return None
    cost_n, cost_r, cost_p, _, wanted = found
    costs = cost_n >= 2 and cost_n & (cost_n - 1) == 0 and 1 <= cost_r <= 32 and 1 <= cost_p <= 16
    fits = costs and 128 * cost_n * cost_r < _MOST_BYTES
    return found if scheme == "scrypt" and fits and len(wanted) == _LENGTH else None
