"""The reasons for each correction: a line for each corrected error whenever the learner gives its reasons."""

from collections.abc import Iterator
from dataclasses import dataclass

from gateway.heard import Explained, MachineSeen
from gateway.web.sentences import Amount, Word
from talc.indicators import TWO_SIDED_95
from talc.names import ERROR_UNITS, LEAST_SHARE_NAMED, THERMAL_ERRORS

_PERCENT = 100.0


@dataclass(frozen=True, slots=True)
class ShownCorrection:
    """One line."""

    t: str
    error: str
    estimate: Amount
    half: Amount
    """Half of the 95 % interval."""
    movers: tuple[tuple[str, Amount], ...]
    """Names of inputs and by how much, the largest first."""
    rest: Amount
    """What other inputs do, and what no input explains."""
    experts: tuple[tuple[Word, Amount], ...]
    """What is believed, with its share."""
    measured: str | None
    """When the last measurement that was used had ended; null: none was heard of."""


def corrections(seen: MachineSeen) -> Iterator[ShownCorrection]:
    """The newest first; errors that are not corrected have no line."""
    for explained in reversed(seen.explained):
        yield from _lines(explained)


def _lines(explained: Explained) -> Iterator[ShownCorrection]:
    message = explained.reasons
    for error in THERMAL_ERRORS:
        reason = message.errors.get(error)
        if reason is None or reason.estimate is None or not reason.trusted:
            continue
        unit, sigma = ERROR_UNITS[error], explained.sigma.get(error)
        rest = None if reason.other_inputs is None or reason.level is None else reason.other_inputs + reason.level
        shares = [(kind, share) for kind, share in reason.experts.items() if share is not None]
        yield ShownCorrection(
            t=message.time,
            error=error,
            estimate=Amount(reason.estimate, unit, sign=True),
            half=Amount(None if sigma is None else TWO_SIDED_95 * sigma, unit),
            movers=tuple((i, Amount(v, unit, sign=True)) for i, v in reason.inputs.items() if v is not None),
            rest=Amount(rest, unit, sign=True),
            experts=tuple(
                (Word(f"expert.{kind.replace(' ', '_')}"), Amount(_PERCENT * share, "%", d=0))
                for kind, share in shares
                if share >= LEAST_SHARE_NAMED
            ),
            measured=None if explained.measured is None else explained.measured.isoformat(),
        )
