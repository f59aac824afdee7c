"""Access to the OPC UA server: who may open a session, and how fast passwords can be guessed."""

import hashlib
import hmac
import logging
import os
from collections.abc import Callable, Mapping
from contextvars import ContextVar
from time import monotonic

from asyncua.crypto.permission_rules import User, UserRole
from asyncua.server.internal_server import InternalServer
from asyncua.server.user_managers import UserManager

from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from gateway.runtime.passwords import GuessingBrake, matches

log = logging.getLogger(__name__)

calling = ContextVar("calling", default="")
"""The address of the client that is served."""


class Readers(UserManager):
    """Decides who may open a session. Nobody may write.

    asyncua asks in its event loop and cannot wait, so each check of a password stops the server for some 50 ms. The
    brake bounds how often that happens. Who has proved a password once is not checked or held up again.

    Parameters
    ----------
    users: name and password hash; empty: everybody, without a name
    now_s: monotonic seconds
    """

    def __init__(self, users: Mapping[str, str], now_s: Callable[[], float] = monotonic) -> None:
        self._users, self._now_s = users, now_s
        self._secret, self._right = os.urandom(32), dict[str, bytes]()
        """Digests of the passwords that were found right, by name."""
        self._brake = GuessingBrake()

    def get_user(
        self,
        iserver: InternalServer,  # noqa: ARG002 - as asyncua calls it
        username: str | None = None,
        password: str | None = None,
        certificate: object = None,  # noqa: ARG002
    ) -> User | None:
        """A user without any right but reading; None: the session is refused."""
        if not self._users:
            return User(role=UserRole.User)
        if username is None or password is None or not self._is_right(username, password):
            return None
        return User(role=UserRole.User, name=username)

    def _is_right(self, name: str, password: str) -> bool:
        digest = hmac.digest(self._secret, password.encode(), hashlib.sha256)
        if hmac.compare_digest(digest, self._right.get(name, b"")):
            return True
        now_s, address, known = self._now_s(), calling.get(), self._users.get(name)
        if self._brake.wait_s(name, now_s, address) > 0.0:
            return False
        right = known is not None and matches(password, known)
        pause_s = self._brake.tried(name, now_s, right=right, address=address, checked=known is not None)
        if right:
            self._right[name] = digest
        elif pause_s:
            log.warning(
                "%s", Text(NoticeCode.PASSWORD_WRONG_AGAIN, user=repr(name)[:64], address=address, pause_s=pause_s)
            )
        return right
