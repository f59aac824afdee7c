"""One probing cycle from the request to the nine errors: ask the NC, wait, check, solve."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Protocol, assert_never

import numpy as np

from drivers.base import Refused
from drivers.nc import FARTHEST_MM, NumericalControl, ProbingState, RequestStatus
from gateway.config.sections import Probing
from gateway.model.codes import NoticeCode
from gateway.model.probing import InForce
from gateway.model.text import Text, failure, plain
from gateway.nc.probing.uninterrupted import to_its_end
from gateway.runtime.clocks import ServiceClock
from talc import probing
from talc.frame import FloatArray

_FIRST_NUMBER_BELOW = 1_000_000
"""Request numbers are sent in R-parameters (64-bit reals) and read by people."""


class Held(Protocol):
    """Offsets that are held."""

    def at(self, centres_mm: FloatArray | None) -> InForce:
        """Offsets in force where the sphere's centres (poses, 3), mm, were found; None: unknown."""
        ...

    async def still(self) -> None:
        """Raises Rejected if something else is in force by now; DriverError."""
        ...


@dataclass(frozen=True, slots=True)
class Probe:
    """The sphere, its poses and the reference: turns the control's centres into thermal errors."""

    poses_rad: FloatArray
    """(poses, 2) A and C."""
    radius_m: float
    height_m: float
    sigma_um: float
    """Standard uncertainty of one coordinate of a measured centre."""

    def deviations_um(self, centres_mm: FloatArray, reference_mm: FloatArray, in_force_um: InForce) -> FloatArray:
        """(poses, 3) movement of the sphere since the reference, µm, as if nothing had been compensated.

        The control adds `in_force_um` to the tool position, so the probe finds the sphere displaced by that much less;
        adding it back gives the machine's own deviation.
        """
        return np.asarray((centres_mm - reference_mm) * 1e3 + np.asarray(in_force_um), dtype=np.float64)

    def solve(self, deviations_um: FloatArray) -> probing.ProbingResult:
        """Nine errors by least squares; see talc.probing."""
        return probing.solve(
            deviations_um, self.poses_rad, radius_m=self.radius_m, height_m=self.height_m, sigma_um=self.sigma_um
        )


def probe_of(settings: Probing) -> Probe:
    """The sphere and its poses from the [probing] section."""
    return Probe(
        poses_in_radians(settings.poses_deg),
        settings.sphere_radius_mm * 1e-3,
        settings.sphere_height_mm * 1e-3,
        settings.sigma_um,
    )


class NotBegun(Exception):
    """No cycle was started; its text says why."""

    def __init__(self, text: Text) -> None:
        super().__init__(text)
        self.text = text


class Rejected(Exception):
    """The cycle failed, or its result cannot be used; its text says why."""

    def __init__(self, text: Text) -> None:
        super().__init__(text)
        self.text = text


async def run_cycle(
    nc: NumericalControl,
    number: int,
    clock: ServiceClock,
    *,
    poll_s: float,
    timeout_s: float,
    told: Callable[[ProbingState], None] = lambda _: None,
) -> RequestStatus:
    """Request cycle `number` and wait for its end. told: gets its state at each look.

    Raises NotBegun when it is refused or has not begun within `timeout_s` (the request is then withdrawn), Rejected
    when it fails or has not ended within as long after it began, DriverError when the control cannot be reached.
    """
    deadline, begun = clock.monotonic() + timeout_s, False
    with clock.hold():
        try:
            await to_its_end(nc.request_probing(number))
        except Refused as error:
            raise NotBegun(Text(NoticeCode.NC_REQUEST_NOT_TAKEN, error=failure(error))) from error
    # Not a Periodic: a look at the state is due poll_s after the answer to the last one. A slow control gets a pause
    # between two looks; the periods of a poller could follow each other at once.
    while True:
        await clock.sleep_until(clock.monotonic() + poll_s)
        with clock.hold():
            status = await to_its_end(nc.probing_status(number))
        told(status.state)
        if ended(status):
            return status
        if not begun and status.state in (ProbingState.ACCEPTED, ProbingState.RUNNING):
            deadline, begun = clock.monotonic() + timeout_s, True  # how long it waited does not cut it short
        if clock.monotonic() > deadline:
            with clock.hold():
                await to_its_end(nc.withdraw_probing(number))
            if begun:
                raise Rejected(Text(NoticeCode.CYCLE_NOT_ENDED, timeout_s=timeout_s))
            raise NotBegun(Text(NoticeCode.CYCLE_NOT_BEGUN, timeout_s=timeout_s))


def _why(status: RequestStatus) -> Text:
    return plain(status.reason) if status.reason else Text(NoticeCode.NO_REASON_GIVEN)


def ended(status: RequestStatus) -> bool:
    """Whether a cycle is done. Raises NotBegun or Rejected when it will not be."""
    match status.state:
        case ProbingState.DONE:
            return True
        case ProbingState.REFUSED:
            raise NotBegun(Text(NoticeCode.NC_CYCLE_REFUSED, why=_why(status)))
        case ProbingState.FAILED:
            raise Rejected(Text(NoticeCode.NC_CYCLE_FAILED, why=_why(status)))
        case ProbingState.IDLE:
            raise NotBegun(Text(NoticeCode.NC_REQUEST_UNKNOWN))
        case ProbingState.REQUESTED | ProbingState.ACCEPTED | ProbingState.RUNNING:
            return False
        case _:
            assert_never(status.state)


def number_after(last: int | None, now: datetime) -> int:
    """Number of the next request; last: of the latest that is stored, None: there is none."""
    return (int(now.timestamp()) % _FIRST_NUMBER_BELOW if last is None else last) + 1


def centres(status: RequestStatus, poses: int) -> FloatArray:
    """(poses, 3) mm. Raises Rejected when the count or a number is wrong."""
    try:
        values = np.asarray(status.centres_mm if status.centres_mm is not None else [], dtype=float)
    except (TypeError, ValueError):
        raise Rejected(Text(NoticeCode.RESULT_NO_POINTS)) from None
    if values.shape != (poses, 3):
        raise Rejected(Text(NoticeCode.RESULT_COUNT, n=values.size, expected=poses * 3))
    if not np.all(np.isfinite(values)):
        raise Rejected(Text(NoticeCode.RESULT_NOT_FINITE))
    if np.max(np.abs(values)) > FARTHEST_MM:
        raise Rejected(Text(NoticeCode.CENTRE_TOO_FAR, most_mm=FARTHEST_MM))
    return values


def at_rest(cycles: Sequence[FloatArray], most_um: float) -> None:
    """Raises Rejected when centres of the reference's cycles, each (poses, 3) mm, are more than `most_um` apart."""
    apart = float(np.max(np.ptp(cycles, axis=0))) * 1e3
    if apart > most_um:
        raise Rejected(Text(NoticeCode.REFERENCE_APART, n=len(cycles), apart_um=apart, most_um=most_um))


def poses_in_radians(poses_deg: Sequence[Sequence[float]]) -> FloatArray:
    """(n, 2) A and C in radians."""
    return np.asarray([[math.radians(a), math.radians(c)] for a, c in poses_deg])
