"""The file of `[talc] prior`: what other machines have learnt."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.bounded_file import bytes_of
from drivers.error_words import in_words
from gateway.model.codes import NoticeCode
from gateway.model.text import Text, text_of
from talc.settings import TalcSettings

if TYPE_CHECKING:
    from talc.learner import Prior

_MOST_BYTES = 2**26


class PriorError(Exception):
    """A prior cannot be used; the text says which file, why and what to do."""


@dataclass(frozen=True, slots=True)
class PriorFile:
    """A prior as its file held it at one moment."""

    text: str
    prior: "Prior" = field(compare=False, repr=False)

    @property
    def content_hash(self) -> str:
        """SHA-256, hexadecimal."""
        return sha256(self.text.encode()).hexdigest()


def prior_for(talc: TalcSettings, names: Sequence[str]) -> PriorFile | None:
    """The prior that `[talc] prior` names, for a machine with these inputs; None without one. Raises PriorError."""
    if talc.prior is None:
        return None
    try:
        found = parse_prior(bytes_of(Path(talc.prior), _MOST_BYTES).decode())
    except OSError as error:
        raise PriorError(Text(NoticeCode.PRIOR_UNREADABLE, path=talc.prior, why=in_words(error))) from None
    except ValueError as error:
        raise PriorError(Text(NoticeCode.PRIOR_USELESS, path=talc.prior, why=text_of(error))) from None
    if not found.prior.known(names):
        theirs = tuple(found.prior.inputs[:3])
        raise PriorError(Text(NoticeCode.PRIOR_OTHER_INPUTS, path=talc.prior, theirs=theirs))
    return found


def parse_prior(text: str) -> PriorFile:
    """The prior in a file's text. Raises ValueError naming the field, its value and what was expected."""
    from talc.learner import Prior  # loads the kernel and NumPy

    try:
        plain = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(Text(NoticeCode.NOT_JSON, error=str(error))) from None
    if not isinstance(plain, dict):
        raise ValueError(Text(NoticeCode.NOT_A_PRIOR))  # noqa: TRY004 -- of a file, not of a caller
    return PriorFile(text, Prior.from_dict(plain))


def described(found: PriorFile, names: Sequence[str]) -> Text:
    """How much of a prior a machine with these inputs can use."""
    known = len(found.prior.known(names))
    machines = int(found.prior.machines.max())
    errors = int((found.prior.machines > 0).sum())
    other = len(found.prior.inputs) - known
    return Text(NoticeCode.PRIOR_IS, machines=machines, errors=errors, known=known, inputs=len(names), other=other)
