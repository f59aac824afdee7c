"""A reader's questions: which gateways run, and what one of them answers to a query or a command."""

import queue
from collections.abc import Sequence
from contextlib import suppress
from typing import Final, TypeVar

import zenoh
from msgspec import Struct

from gateway.model.codes import NoticeCode
from gateway.model.commands import CommandName
from gateway.model.text import Text, text_of
from gateway.telemetry import keys
from gateway.telemetry.answers import CommandAnswer, CommandTerms, QueryRefused
from gateway.telemetry.codec import decode_answer, decode_refusal
from gateway.telemetry.command_signer import CommandSigner

_Answer = TypeVar("_Answer", bound=Struct)
_OTHERS_S = 1.0
"""How long a second answer is waited for."""
COMMAND_LIMIT_S: Final = 70.0
"""How long to wait for the answer to a command: the gateway waits for its disk."""


class SeveralAnswer(OSError):
    """More than one gateway answers under one name; the message says what to do."""

    def __init__(self, many: int) -> None:
        mixed = f"{many} gateways answer under this name, and their messages would be mixed"
        super().__init__(f"{mixed}; give each its own [machine] name")


class QueryRefusal(OSError):
    """The gateway has answered that it does not answer this, and why."""

    def lacks(self, parameter: str) -> bool:
        """Whether its program may be too old for this parameter of a query: it says so, or has no codes yet."""
        said = text_of(self)
        return not said.code or (said.says(NoticeCode.PARAMETER_UNKNOWN) and said.value_of("name") == parameter)


class Unanswered(OSError):
    """Nobody has answered in time."""

    def __init__(self, limit_s: float) -> None:
        super().__init__(Text(NoticeCode.QUERY_UNANSWERED, limit_s=limit_s))


def running(session: zenoh.Session, prefix: str, limit_s: float) -> list[str]:
    """The machines under a prefix whose gateways run now, by name; blocks for at most `limit_s`."""
    replies = session.liveliness().get(f"{keys.root(prefix, '*')}/{keys.ALIVE}", timeout=limit_s)
    found = {str(reply.ok.key_expr).split("/")[-2] for reply in replies if reply.ok is not None}
    return sorted(name for name in found if keys.MACHINE.fullmatch(name))


def ask(session: zenoh.Session, selector: str, answer: type[_Answer], limit_s: float) -> _Answer:
    """The first answer to a query; blocks for at most `limit_s`.

    Raises OSError with what the gateway says when it refuses, or that it says nothing; ValueError for an answer that
    is not of this type.
    """
    return decode_answer(answer, _first(session, selector, limit_s).payload.to_bytes())


def ask_only(sessions: Sequence[zenoh.Session], selector: str, answer: type[_Answer], limit_s: float) -> _Answer:
    """As `ask` at all of these, but waits a moment for others, and takes no answer when two gateways give one.

    Raises SeveralAnswer then, else as `ask`.
    """
    every = zenoh.ConsolidationMode.NONE  # else one of several answers of one key is passed on
    replies = queue.Queue[zenoh.Reply | None]()
    for session in sessions:
        take = zenoh.handlers.Callback(replies.put, lambda: replies.put(None))
        session.get(selector, take, timeout=limit_s, consolidation=every)
    found, last, wait_s, asked = dict[str, zenoh.Sample](), None, limit_s + _OTHERS_S, len(sessions)
    with suppress(queue.Empty):  # one that has just gone is waited for by Zenoh itself, until the limit
        while asked:
            if (reply := replies.get(timeout=wait_s)) is None:
                asked -= 1
                continue
            if reply.ok is not None:
                found[str(reply.replier_id)], wait_s = reply.ok, _OTHERS_S
            last = reply
    if len(found) > 1:
        raise SeveralAnswer(len(found))
    for sample in found.values():
        return decode_answer(answer, sample.payload.to_bytes())
    if last is not None and last.err is not None:
        raise _error(last.err.payload.to_bytes(), limit_s)
    raise Unanswered(limit_s)


def command(
    sessions: Sequence[zenoh.Session], root: str, by: CommandSigner, name: CommandName, limit_s: float
) -> CommandAnswer:
    """Give the gateway whose keys begin with `root` a command; blocks for at most `limit_s`, twice.

    The answer may be a refusal. Raises OSError as `ask_only`, SeveralAnswer before anything is commanded; ValueError if
    what answers does not hold the operator's key.
    """
    key = f"{root}/{keys.COMMAND}"
    signed = by.sign(name, ask_only(sessions, key, CommandTerms, limit_s), root.rpartition("/")[2])
    found = _first(sessions[0], f"{key}/{name.value}", limit_s, signed.payload, signed.signature)
    proof = found.attachment
    return signed.answered(found.payload.to_bytes(), b"" if proof is None else proof.to_bytes())


def _first(
    session: zenoh.Session, selector: str, limit_s: float, payload: bytes | None = None, proof: bytes | None = None
) -> zenoh.Sample:
    for reply in session.get(selector, timeout=limit_s, payload=payload, attachment=proof):
        if reply.ok is not None:
            return reply.ok
        if reply.err is not None:
            raise _error(reply.err.payload.to_bytes(), limit_s)
    raise Unanswered(limit_s)


def _error(payload: bytes, limit_s: float) -> OSError:
    """A gateway's refusal; what is none is Zenoh's `Timeout`, for a gateway that is there and has not answered."""
    try:
        decode_answer(QueryRefused, payload)
    except ValueError:
        return Unanswered(limit_s)
    return QueryRefusal(decode_refusal(payload))
