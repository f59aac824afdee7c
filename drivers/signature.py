"""Signatures of a session: both sides prove a shared key, and nothing signed in one session counts in another."""

import hmac
from pathlib import Path

from drivers.bounded_file import bytes_of
from drivers.text import Text

SHORTEST_KEY = 32
"""Characters."""


def shared_key(path: Path) -> bytes:
    """The key in a file. Raises OSError, or ValueError when it is too short to be a key."""
    key = bytes_of(path).strip()
    if len(key) < SHORTEST_KEY:
        raise ValueError(Text("key_short", count=len(key), least=SHORTEST_KEY))
    return key


def session_key(key: bytes, challenge: str, nonce: str) -> bytes:
    """The session's own key. challenge: random, of the side that is asked; nonce: random, of the side that asks."""
    return hmac.digest(key, f"{challenge} {nonce}".encode(), "sha256")


def signature(session: bytes, who: str, count: int, text: bytes) -> bytes:
    """The signature of one text, hexadecimal. who: the side that sends it; count: how many exchanges of the session
    came before."""
    return hmac.digest(session, f"{who} {count} ".encode() + text, "sha256").hex().encode()


def is_signed(session: bytes, who: str, count: int, text: bytes, given: bytes) -> bool:
    """Whether `given` is that signature; takes as long for every wrong one."""
    return hmac.compare_digest(signature(session, who, count, text), given)
