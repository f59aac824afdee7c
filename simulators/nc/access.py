"""Access to the emulated control: users with rights, and trusted certificates."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.crypto.permission_rules import User as Session
from asyncua.crypto.permission_rules import UserRole
from asyncua.crypto.uacrypto import load_certificate
from asyncua.crypto.validator import CertificateValidatorMethod
from asyncua.server.user_managers import UserManager
from asyncua.ua.status_codes import StatusCodes
from cryptography import x509

from simulators.nc.variables import AccessRight

APPLICATION_URI = "urn:emulated:sinumerik"
ALL_RIGHTS = frozenset(AccessRight)
NOBODY = Session(role=UserRole.Anonymous)


@dataclass(frozen=True, slots=True)
class User:
    """A user of the control, and the user's rights."""

    password: str
    rights: frozenset[AccessRight] = ALL_RIGHTS


@dataclass(frozen=True, slots=True)
class Security:
    """Policies of OPC UA 1.04 with SignAndEncrypt, and nothing else."""

    certificate: Path
    """The control's, .pem or .der; its application URI is APPLICATION_URI."""
    private_key: Path
    trusted: tuple[Path, ...]
    """Certificates of the accepted clients."""


def only(files: tuple[Path, ...]) -> CertificateValidatorMethod:
    """Accept clients with one of the certificates while it is valid."""

    async def validate(certificate: x509.Certificate, _: ua.ApplicationDescription) -> None:
        if certificate not in [await load_certificate(file) for file in files]:
            raise ServiceError(StatusCodes.BadCertificateUntrusted)
        if not certificate.not_valid_before_utc <= datetime.now(UTC) <= certificate.not_valid_after_utc:
            raise ServiceError(StatusCodes.BadCertificateTimeInvalid)

    return validate


class Users(UserManager):
    """Checks name and password, and knows all users' rights. None: everybody has all rights."""

    def __init__(self, users: Mapping[str, User] | None) -> None:
        self._users = users

    def get_user(
        self,
        iserver: object,  # noqa: ARG002 the library's interface
        username: str | None = None,
        password: str | None = None,
        certificate: object = None,  # noqa: ARG002
    ) -> Session | None:
        if self._users is None:
            return Session(role=UserRole.User)
        user = self._users.get(username or "")
        return Session(role=UserRole.User, name=username) if user is not None and user.password == password else None

    def rights(self, session: Session) -> frozenset[AccessRight]:
        """The rights of a logged-in user."""
        if self._users is None:
            return ALL_RIGHTS
        user = self._users.get(session.name or "")
        return user.rights if user is not None else frozenset()
