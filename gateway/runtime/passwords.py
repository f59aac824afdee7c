"""Password hashes: scrypt, as `scrypt$n$r$p$salt$hash` with the last two in Base64."""

import hashlib
import hmac
import os
from base64 import b64decode, b64encode
from binascii import Error as NotBase64
from collections import OrderedDict, deque
from typing import Annotated

import click
from pydantic import AfterValidator

from drivers.section import matching
from gateway.model.codes import NoticeCode
from gateway.model.text import Text

_N, _R, _P = 2**14, 8, 1
"""16 MB and some 50 ms for each attempt (RFC 7914)."""
_MOST_BYTES = 64 * 2**20
_SALT = 16
_LENGTH = 32

_FREE = 5
"""Wrong passwords without a pause."""
_FIRST_S = 1.0
"""The pause after the next one."""
_LONGEST_S = 300.0
"""The longest pause."""
_MOST = 20
"""Passwords that are checked within that time, of all names together: each takes a processor for some 50 ms."""
_MOST_REMEMBERED = 1000
"""Names and addresses."""
_WITHIN_S = 60.0
"""The time within which they are counted."""


class GuessingBrake:
    """Slows down guessing, at every door. After five wrong passwords for a name, or from an address, the next one is
    not looked at for 1, 2, 4 … 300 s; a right one ends that. Of all together 20 a minute are checked.

    Times are monotonic seconds.
    """

    def __init__(self) -> None:
        self._wrong = OrderedDict[str, tuple[int, float]]()
        """By name or address: how many in a row, and until when the next one is not looked at."""
        self._checked_s = deque[float](maxlen=_MOST)

    def wait_s(self, name: str, now_s: float, address: str = "") -> float:
        """How long until a password for this name from this address is checked; 0: now."""
        until_s = max((self._wrong[who][1] for who in _who(name, address) if who in self._wrong), default=now_s)
        many = len(self._checked_s) == _MOST
        return max(0.0, until_s - now_s, self._checked_s[0] + _WITHIN_S - now_s if many else 0.0)

    def tried(self, name: str, now_s: float, *, right: bool, address: str = "", checked: bool = True) -> float:
        """A password was found right or wrong; returns for how long the next one is not looked at.

        checked: whether it took a processor; one for a name that nobody has does not, and then only the address counts
        """
        if checked:
            self._checked_s.append(now_s)
        longest_s = 0.0
        for who in _who(name if checked else "", address):
            if right:
                self._wrong.pop(who, None)
                continue
            many = self._wrong.get(who, (0, 0.0))[0] + 1
            pause_s = 0.0 if many < _FREE else min(_FIRST_S * 2.0 ** min(many - _FREE, 20), _LONGEST_S)
            self._wrong[who] = many, now_s + pause_s
            self._wrong.move_to_end(who)
            longest_s = max(longest_s, pause_s)
        while len(self._wrong) > _MOST_REMEMBERED:
            self._wrong.popitem(last=False)
        return longest_s


def _who(name: str, address: str) -> tuple[str, ...]:
    """What is counted; a name holds no colon."""
    return tuple(who for who in (name, f":{address}" if address else "") if who)


def make_hash(password: str) -> str:
    """The hash of a password, with its own salt."""
    salt = os.urandom(_SALT)
    return _hash_text(salt, _hashed(password, salt, _N, _R, _P))


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


def _hash_text(salt: bytes, digest: bytes) -> str:
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


def hash_printed_by(command: str) -> AfterValidator:
    """A validator of the hashes in the settings of `talc-gateway` COMMAND."""

    def check(text: str) -> str:
        if not is_hash(text):
            raise ValueError(Text(NoticeCode.NOT_A_HASH, command=command))
        return text

    return AfterValidator(check)


UserName = Annotated[str, matching(r"[^:\x00-\x1f]+", NoticeCode.A_USER_NAME)]
"""The name of a user whose password hash is kept."""


def ask_password() -> None:
    """Ask for a password, twice on a terminal, and print its hash."""
    click.echo(make_hash(click.prompt("password", hide_input=True, confirmation_prompt=True, err=True)))
