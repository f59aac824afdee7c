"""The file of `[talc] prior`: what other machines have learnt."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

from gateway.model.codes import NoticeCode
from gateway.model.text import Text
from talc.settings import TalcSettings

if TYPE_CHECKING:
    from talc.learner import Prior

_REMEDY = "make one with `talc-gateway prior make`, or remove this line"


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
        found = parse_prior(Path(talc.prior).read_text(encoding="utf-8"))
    except OSError as error:
        raise PriorError(f"'{talc.prior}' cannot be read: {error.strerror or error}; {_REMEDY}") from None
    except ValueError as error:
        raise PriorError(f"'{talc.prior}': {error}; {_REMEDY}") from None
    if not found.prior.known(names):
        theirs = ", ".join(found.prior.inputs[:3])
        raise PriorError(
            f"'{talc.prior}': none of its inputs ({theirs}, ...) has the name of an input here; inputs are matched by "
            f"name: use the same names on machines of one kind, or remove this line"
        )
    return found


def parse_prior(text: str) -> PriorFile:
    """The prior in a file's text. Raises ValueError naming the field, its value and what was expected."""
    from talc.learner import Prior  # loads the kernel and NumPy

    try:
        plain = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"is not JSON: {error}") from None
    if not isinstance(plain, dict):
        raise ValueError("is not a prior: expected a table")  # noqa: TRY004 -- of a file, not of a caller
    return PriorFile(text, Prior.from_dict(plain))


def described(found: PriorFile, names: Sequence[str]) -> Text:
    """How much of a prior a machine with these inputs can use."""
    known = len(found.prior.known(names))
    machines = int(found.prior.machines.max())
    errors = int((found.prior.machines > 0).sum())
    other = len(found.prior.inputs) - known
    return Text(NoticeCode.PRIOR_IS, machines=machines, errors=errors, known=known, inputs=len(names), other=other)
