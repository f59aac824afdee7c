"""Problems reported for one bus: the bus itself, its devices, their channels, and missed periods."""

from collections.abc import Mapping, Sequence

from drivers.base import DriverError, Reading, SharedLine
from gateway.acquisition.line import Line
from gateway.acquisition.pace import Pace
from gateway.runtime.problems import Problems

OTHER_MASTER = "another master is on this line"
"""In the text of the problem."""
NO_OTHER_MASTER = "no other master is heard any more"
"""In the text of its end."""


class LineReports:
    """The problems of one line, in words."""

    def __init__(self, line: Line, problems: Problems) -> None:
        self._bus, self._limit_s, self._problems = line.bus.name, line.read_limit_s, problems
        self._shared = line.bus if isinstance(line.bus, SharedLine) else None
        self._pace = Pace(line.period_s)

    def failed(self, subject: str, error: Exception, kind: str = "") -> str:
        """A bus could not be opened, or a device could not be read; returns why, in words.

        kind: identifies the same problem; by default the error's class
        """
        expected = isinstance(error, DriverError | TimeoutError)
        text = self._text(subject, error)
        self._problems.report(subject, kind or type(error).__name__, text, bug=None if expected else error)
        return text

    def _text(self, subject: str, error: Exception) -> str:
        match error:
            case DriverError():
                return str(error)
            case TimeoutError():
                return f"{subject}: did not finish within {self._limit_s:g} s"
            case _:
                return f"{subject}: unexpected {type(error).__name__}: {error}"

    def opened(self, subject: str) -> None:
        """The bus is open."""
        self._problems.clear(subject, f"{subject}: open again")

    def answered(self, subject: str, readings: Sequence[Reading]) -> None:
        """A device answered; some of its channels may still be bad."""
        if self._problems.none_lately and all(reading.quality.usable for reading in readings):
            return  # as almost always
        self._problems.clear(subject, f"{subject}: answers again")
        for reading in readings:
            channel, quality = f"channel {reading.channel}", reading.quality.value
            if reading.quality.usable:
                self._problems.clear(channel, f"{channel}: good again")
            else:
                why = f": {reading.detail}" if reading.detail else ""
                self._problems.report(channel, quality, f"{channel}: {quality}{why}")

    def polled(self, answered_s: Mapping[str, float], missed: int) -> None:
        """A period has passed: how long each answering device took, s, and how many periods were missed meanwhile."""
        subject = f"period of bus {self._bus}"
        self._pace.polled(answered_s, missed)
        if self._pace.slow:
            self._problems.report(subject, "slow", f"bus {self._bus}: {self._pace.text()}")
        else:
            self._problems.clear(subject, f"{subject}: the devices answer in time again")
        if self._shared is not None:
            self._shared_by(self._shared)

    def _shared_by(self, line: SharedLine) -> None:
        subject = f"line of bus {self._bus}"
        try:
            evidence = line.other_master()
        except MemoryError:
            raise
        except Exception as error:  # noqa: BLE001 - a driver's bug must not end the other buses
            self.failed(subject, error)
            return
        if evidence:
            advice = "only one may ask; end the other, or connect it to another line"
            self._problems.report(subject, "shared", f"bus {self._bus}: {OTHER_MASTER}: {evidence} ({advice})")
        else:
            self._problems.clear(subject, f"bus {self._bus}: {NO_OTHER_MASTER}")
