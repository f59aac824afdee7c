"""The reasons for each correction: a line for each corrected error whenever the learner gives its reasons."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from gateway.listeners.web.sentences import Amount, Word
from gateway.telemetry.messages import PublishedReason
from gateway.telemetry.subscriber.machine import MachineSeen
from talc.indicators import TWO_SIDED_95
from talc.names import ERROR_UNITS, LEAST_SHARE_NAMED, THERMAL_ERRORS

_PERCENT = 100.0


@dataclass(frozen=True, slots=True)
class ShownCorrection:
    """One line."""

    t: str
    k: int
    """Grid index."""
    error: str
    estimate: Amount
    half: Amount
    """Half of the 95 % interval."""
    movers: tuple[tuple[str, Amount], ...]
    """Names of inputs and by how much, the largest first."""
    rest: Amount
    """What other inputs do, and what no input explains."""
    level: Amount
    """Of it, what no input explains."""
    experts: tuple[tuple[Word, Amount], ...]
    """Kind of expert, with its weight."""
    measured: str | None
    """When the last measurement that was used had ended; null: none was heard of."""


def corrections(seen: MachineSeen) -> Iterator[ShownCorrection]:
    """The newest first; errors that are not corrected have no line."""
    for explained in reversed(seen.explained):
        reasons, measured = explained.reasons, explained.measured
        used = None if measured is None else measured.isoformat()
        yield from correction_lines(reasons.time, reasons.k, reasons.errors, explained.sigma, used)


def correction_lines(
    time: str,
    k: int,
    errors: Mapping[str, PublishedReason],
    sigma_of: Mapping[str, float | None],
    measured: str | None,
) -> Iterator[ShownCorrection]:
    """Those of one step. errors, sigma_of: by thermal error; measured: when the last measurement had ended."""
    for error in THERMAL_ERRORS:
        reason = errors.get(error)
        if reason is None or reason.estimate is None or not reason.trusted:
            continue
        unit, sigma = ERROR_UNITS[error], sigma_of.get(error)
        # Rounded parts add up to the rounded sum: what rounding leaves is in the rest.
        movers = tuple((i, Amount(round(v, 1), unit, sign=True)) for i, v in reason.inputs.items() if v is not None)
        rest = round(reason.estimate, 1) - sum(amount.n or 0.0 for _, amount in movers)
        shares = [(kind, share) for kind, share in reason.experts.items() if share is not None]
        yield ShownCorrection(
            t=time,
            k=k,
            error=error,
            estimate=Amount(reason.estimate, unit, sign=True),
            half=Amount(None if sigma is None else TWO_SIDED_95 * sigma, unit),
            movers=movers,
            rest=Amount(round(rest, 1), unit, sign=True),
            level=Amount(round(reason.level or 0.0, 1), unit, sign=True),
            experts=tuple(
                (Word(f"expert.{kind.replace(' ', '_')}"), Amount(_PERCENT * share, "%", d=0))
                for kind, share in shares
                if share >= LEAST_SHARE_NAMED
            ),
            measured=measured,
        )
