"""Lets in commands of operators who prove their key, each once; it refuses anything else. Uses no network.

A few of the refused commands are stored.

A command is signed for one challenge of this run of the gateway, so it needs no clock that is right, and what somebody
recorded or held back is of no use later or elsewhere.
"""

import hmac
import logging
import secrets
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial

from drivers.signature import is_signed, session_key, signature
from gateway.model.codes import NoticeCode
from gateway.model.commands import BY_CAUTION, UNPROVED, Command, CommandName, CommandOutcome, Refusals
from gateway.model.text import NOTHING, Text, plain
from gateway.telemetry import keys
from gateway.telemetry.answers import CommandAnswer, CommandRequest, CommandTerms
from gateway.telemetry.codec import decode_answer, encode
from gateway.telemetry.fields import coded
from gateway.telemetry.queries import AskedQuery, Replied, Work

log = logging.getLogger(__name__)

VALID_S = 30.0
ASKER = "client"
"""Signs requests."""
GATEWAY = "gateway"
"""Signs answers."""
_LONGEST = 4096
_LONGEST_REASON = 300
_TELL_EVERY_S = 60.0

Give = Callable[[Command, Text], CommandOutcome]
"""Carries out a command, or refuses it for the reason that is given. Raises OSError while nobody does."""


@dataclass(frozen=True, slots=True)
class Entitled:
    """What one operator is entitled to."""

    key: bytes
    may: frozenset[CommandName]


class Challenges:
    """Random texts, each good for one command within VALID_S. Only those that were used are remembered, so that asking
    for many costs nothing."""

    def __init__(self) -> None:
        self._secret = secrets.token_bytes(32)
        self._used: dict[str, float] = {}

    def issue(self, now_s: float) -> str:
        """A new one."""
        text = f"{now_s:.3f} {secrets.token_hex(16)}"
        return f"{text} {self._mark(text)}"

    def use(self, challenge: str, now_s: float) -> None:
        """Use it up. Raises ValueError if it was used, has expired, or is of another gateway or run."""
        text, _, mark = challenge.rpartition(" ")
        if not hmac.compare_digest(self._mark(text).encode(), mark.encode()):
            raise ValueError("the challenge is not of this run of this gateway; ask for another one")
        if now_s - (issued_s := float(text.split()[0])) > VALID_S:
            raise ValueError(f"the challenge is older than {VALID_S:g} s; ask for another one")
        self._used = {one: at for one, at in self._used.items() if now_s - at <= VALID_S}
        if challenge in self._used:
            raise ValueError("this command was already given; each command needs its own challenge")
        self._used[challenge] = issued_s

    def _mark(self, text: str) -> str:
        return hmac.digest(self._secret, text.encode(), "sha256").hex()


class CommandDoor:
    """Answers queries on `command` and `command/<name>`; one at a time.

    Parameters
    ----------
    machine: of this gateway
    operators: by name
    give: carries a command out, and stores the outcome
    monotonic: seconds, in which VALID_S counts: real ones, also where the machine's time is simulated
    """

    def __init__(
        self, machine: str, operators: Mapping[str, Entitled], give: Give, monotonic: Callable[[], float]
    ) -> None:
        self._machine, self._operators, self._give, self._monotonic = machine, dict(operators), give, monotonic
        self._challenges = Challenges()
        self._strangers, self._told_s = 0, -_TELL_EVERY_S
        self._refusals = Refusals()

    def answer(self, asked: AskedQuery) -> Replied:
        """A gateway.telemetry.queries.Answering."""
        found = self.sift(asked)
        return found.answer() if isinstance(found, Work) else found

    def sift(self, asked: AskedQuery) -> Replied | Work:
        """A gateway.telemetry.queries.Sifting: only a command that is proved, and the few refusals that are stored, are
        any work."""
        if asked.below:
            return self._command(asked)
        challenge = self._challenges.issue(self._monotonic())
        return Replied(encode(CommandTerms(self._machine, challenge, VALID_S, tuple(CommandName))))

    def _command(self, asked: AskedQuery) -> Work:
        if asked.below not in list(CommandName):
            raise ValueError(f"{asked.below!r}: expected one of {', '.join(CommandName)}")
        name = CommandName(asked.below)
        claimed = ""
        try:
            request = self._request(asked)
            claimed = f"{request.by!r:.64}"
            operator, session = self._let_in(request, asked)
        except ValueError as error:
            why = plain(str(error)[:_LONGEST_REASON])
            stored = self._refusals.stored(
                Text(NoticeCode.NOT_LET_IN, why=why, by=claimed) if claimed else why, self._monotonic()
            )
            if stored is None:
                raise
            return Work(partial(self._store_refusal, name, stored, error), urgent=False)
        return Work(partial(self._given, name, request, operator, session), urgent=name in BY_CAUTION)

    def _given(self, name: CommandName, request: CommandRequest, operator: Entitled, session: bytes) -> Replied:
        refused = NOTHING if name in operator.may else Text(NoticeCode.MAY_NOT, by=request.by)
        outcome = self._give(Command(name, request.by), refused)
        payload = encode(
            CommandAnswer(
                self._machine,
                name.value,
                request.by,
                outcome.time.isoformat(),
                outcome.accepted,
                str(outcome.text),
                coded(outcome.text),
            )
        )
        return Replied(payload, signature(session, GATEWAY, 0, payload))

    def _request(self, asked: AskedQuery) -> CommandRequest:
        if len(asked.payload) > _LONGEST:
            raise ValueError(f"a payload of {len(asked.payload)} bytes: expected at most {_LONGEST}")
        return decode_answer(CommandRequest, asked.payload)

    def _let_in(self, request: CommandRequest, asked: AskedQuery) -> tuple[Entitled, bytes]:
        """Whose it is, and the session's key; its challenge is used up. Raises ValueError."""
        operator, session = self._proved(request, asked)
        for what, given, wanted in (
            ("machine", request.machine, self._machine),
            ("name", request.name, asked.below),
        ):
            if given != wanted:
                raise ValueError(
                    f"{what} = {given!r}: this is {wanted!r}; a command counts for one machine and one name"
                )
        self._challenges.use(request.challenge, self._monotonic())
        return operator, session

    def _store_refusal(self, name: CommandName, text: Text, error: ValueError) -> Replied:
        """In nobody's name: a signature that was recorded and sent again proves no person either. Raises the error."""
        with suppress(OSError):  # the gateway is starting or stopping
            self._give(Command(name, UNPROVED), text)
        raise error

    def _proved(self, request: CommandRequest, asked: AskedQuery) -> tuple[Entitled, bytes]:
        """Whose command this is, and the session's key. Raises ValueError, which does not tell names from keys."""
        operator = self._operators.get(request.by)
        key = secrets.token_bytes(32) if operator is None else operator.key
        session = session_key(key, request.challenge, request.nonce)
        signed = is_signed(session, ASKER, 0, asked.payload, asked.attachment)
        if operator is None or not signed:
            self._tell_strangers(request.by)
            raise ValueError("by and key are not those of an operator of this gateway")
        return operator, session

    def _tell_strangers(self, by: str) -> None:
        self._strangers += 1
        now_s = self._monotonic()
        if now_s - self._told_s >= _TELL_EVERY_S:
            self._told_s = now_s
            log.warning(
                "%s", Text(NoticeCode.STRANGERS_REFUSED, key=keys.COMMAND, n=self._strangers, user=repr(by)[:64])
            )
