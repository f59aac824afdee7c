"""The side that gives commands: signs them with an operator's key, and rejects unsigned answers."""

import secrets
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

from drivers.signature import is_signed, session_key, shared_key, signature
from gateway.model.commands import CommandName
from gateway.telemetry.answers import CommandAnswer, CommandRequest, CommandTerms
from gateway.telemetry.codec import decode_answer, encode
from gateway.telemetry.command_door import ASKER, GATEWAY


@dataclass(frozen=True, slots=True)
class SignedCommand:
    """What is sent, and what its answer must be signed with."""

    payload: bytes
    signature: bytes
    _session: bytes = field(repr=False)

    def answered(self, payload: bytes, given: bytes) -> CommandAnswer:
        """The answer. Raises ValueError unless it is signed for this command."""
        if not is_signed(self._session, GATEWAY, 0, payload, given):
            raise ValueError("the answer does not come from a gateway with this key")
        return decode_answer(CommandAnswer, payload)


@dataclass(frozen=True, slots=True)
class CommandSigner:
    """An operator: a name and a key, as in [[telemetry.operator]] of the gateway."""

    name: str
    key: bytes = field(repr=False)

    @classmethod
    def of_file(cls, name: str, path: Path) -> Self:
        """With the key in a file. Raises OSError, or ValueError if the file holds no key."""
        try:
            return cls(name, shared_key(path))
        except ValueError as error:
            raise ValueError(f"{path} {error}") from None

    def sign(self, name: CommandName, terms: CommandTerms, machine: str) -> SignedCommand:
        """A command to this machine, for the challenge in `terms`."""
        request = CommandRequest(machine, name.value, self.name, terms.challenge, secrets.token_hex(32))
        payload, session = encode(request), session_key(self.key, request.challenge, request.nonce)
        return SignedCommand(payload, signature(session, ASKER, 0, payload), session)
