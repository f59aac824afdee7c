"""The connection to one control: opened when the breaker allows it, checked, and closed after every error."""

import logging
from dataclasses import replace

from drivers.base import ConnectError, DriverError, NoAnswer, Quality
from drivers.nc import NcSnapshot, NumericalControl
from gateway.model.codes import NoticeCode
from gateway.model.text import Text, failure
from gateway.nc.motion import Motion
from gateway.runtime.boundary import UnexpectedError
from gateway.runtime.breaker import Breaker
from gateway.runtime.problems import Problems

log = logging.getLogger(__name__)

_LONGEST_RETRY_PERIODS = 30
_SUBJECT = "NC"
_VALUES = "values of NC"
_AXES = "axes of NC"


class Session:
    """One control's connection.

    Parameters
    ----------
    nc: the driver; nothing is opened before `connect`
    period_s: time between two snapshots
    frozen_after_s: see Motion
    problems: told of each as it begins and as it ends
    """

    def __init__(
        self,
        nc: NumericalControl,
        *,
        period_s: float,
        frozen_after_s: float,
        problems: Problems,
    ) -> None:
        self._nc, self._problems = nc, problems
        self._breaker = Breaker(period_s, period_s * _LONGEST_RETRY_PERIODS)
        self._motion = Motion(frozen_after_s)
        self._latest: NcSnapshot | None = None
        self._tried = False

    @property
    def tried(self) -> bool:
        """Whether the first attempt to reach the control has succeeded or failed."""
        return self._tried

    @property
    def latest(self) -> NcSnapshot | None:
        """The control's latest state; None while it cannot be reached."""
        return self._latest

    def may_connect(self, now_s: float) -> bool:
        """Whether the control may be tried again."""
        return self._breaker.allows(now_s)

    async def connect(self) -> None:
        """Raises DriverError."""
        await self._nc.connect()

    async def look(self) -> NcSnapshot:
        """The control's present state; of quality `stale` when its values are frozen. Raises DriverError."""
        self._latest = self._judged(await self._nc.snapshot())
        self._tell_not_known(self._latest)
        self._tried = True
        return self._latest

    async def lost(self, error: DriverError, due_s: float) -> None:
        """Close after an error of the period that was due at `due_s`, and report the problem once."""
        await self.close()
        self._tried = True
        self._breaker.failed(due_s)
        # A cut connection and a silent one are the same problem.
        kind = "line" if isinstance(error, ConnectError | NoAnswer) else type(_root(error)).__name__
        self._problems.report(_SUBJECT, Text(NoticeCode.NC_NOT_CONNECTED, error=failure(error)), kind)

    def works(self) -> None:
        """A whole period passed without an error. A connection alone proves nothing: a request that is refused after
        each connection would otherwise be repeated every period."""
        self._breaker.succeeded()
        self._problems.clear(_SUBJECT, NoticeCode.NC_CONNECTED_AGAIN)

    async def close(self) -> None:
        """Never raises DriverError."""
        self._latest = None
        try:
            await self._nc.close()
        except DriverError as error:
            log.debug("closing the NC: %s", error)

    def _judged(self, snapshot: NcSnapshot) -> NcSnapshot:
        frozen = self._motion.frozen(snapshot)
        if frozen:
            self._problems.report(_AXES, Text(NoticeCode.NC_AXES_FROZEN, axes=tuple(frozen)))
        else:
            self._problems.clear(_AXES, NoticeCode.NC_AXES_MOVE)
        return replace(snapshot, quality=Quality.STALE) if frozen else snapshot

    def _tell_not_known(self, snapshot: NcSnapshot) -> None:
        """Once for each set of names: the values may change with each snapshot."""
        if found := snapshot.not_known:
            listed = tuple(f"{name} = {text}" for name, text in found.items())
            self._problems.report(_VALUES, Text(NoticeCode.NC_VALUES_UNKNOWN, values=listed), ", ".join(found))
        else:
            self._problems.clear(_VALUES, NoticeCode.NC_VALUES_KNOWN)


def _root(error: DriverError) -> BaseException:
    """The cause of an unexpected error: two causes of different kinds are two problems."""
    return error.__cause__ or error if isinstance(error, UnexpectedError) else error
