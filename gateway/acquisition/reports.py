"""Problems reported for one bus: the bus itself, its devices, their channels, and missed periods."""

from collections.abc import Mapping, Sequence

from drivers.base import DriverError, Learns, NoAnswer, Reading, SharedLine
from gateway.acquisition.line import Line
from gateway.acquisition.pace import Pace
from gateway.model.codes import NoticeCode
from gateway.model.text import Text, failure
from gateway.runtime.problems import Problems


class LineReports:
    """The problems of one line."""

    def __init__(self, line: Line, problems: Problems) -> None:
        self._bus, self._limit_s, self._problems = line.bus.name, line.read_limit_s, problems
        self._shared = line.bus if isinstance(line.bus, SharedLine) else None
        self._learns = line.bus if isinstance(line.bus, Learns) else None
        self._pace = Pace(line.period_s)
        self._period, self._wire = (Text(code, name=self._bus) for code in (NoticeCode.BUS_PERIOD, NoticeCode.BUS_LINE))
        self._channels: dict[str, Text] = {}
        self.answers_s: Mapping[int, float] = {}
        """How long each unit usually takes to answer, where the bus finds it out."""

    def failed(self, subject: Text, error: Exception, kind: str = "") -> str:
        """A bus could not be opened, or a device could not be read; returns why, in words.

        kind: identifies the same problem; by default the error's class
        """
        expected = isinstance(error, DriverError | TimeoutError)
        text = self._text(subject, error)
        kind = kind or ("NoAnswer" if isinstance(error, NoAnswer) else type(error).__name__)
        self._problems.report(subject, text, kind, bug=None if expected else error)
        return text

    def _text(self, subject: Text, error: Exception) -> Text:
        match error:
            case DriverError():
                return failure(error)
            case TimeoutError():
                return Text(NoticeCode.NOT_FINISHED, subject=subject, limit_s=self._limit_s)
            case _:
                return Text(NoticeCode.UNEXPECTED, subject=subject, kind=type(error).__name__, error=str(error))

    def opened(self, subject: Text) -> None:
        """The bus is open."""
        self._problems.clear(subject, NoticeCode.OPENED_AGAIN, subject=subject)

    def answered(self, subject: Text, readings: Sequence[Reading]) -> None:
        """A device answered; some of its channels may still be bad."""
        self._problems.clear(subject, NoticeCode.ANSWERS_AGAIN, subject=subject)
        for reading in readings:
            channel = self._channel(reading.channel)
            if reading.quality.usable:
                self._problems.clear(channel, NoticeCode.CHANNEL_GOOD_AGAIN, channel=reading.channel)
            else:
                self._problems.report(channel, channel_bad(reading), reading.quality.value)

    def _channel(self, name: str) -> Text:
        if name not in self._channels:
            self._channels[name] = Text(NoticeCode.CHANNEL, name=name)
        return self._channels[name]

    def polled(self, answered_s: Mapping[str, float], missed: int) -> None:
        """A period has passed: how long each answering device took, s, and how many periods were missed meanwhile."""
        self._pace.polled(answered_s, missed)
        if self._pace.slow:
            self._problems.report(self._period, self._pace.text(self._bus))
        else:
            self._problems.clear(self._period, NoticeCode.BUS_IN_TIME, bus=self._bus)
        if self._shared is not None:
            self._shared_by(self._shared)
        if self._learns is not None:
            self._learnt_by(self._learns)

    def _learnt_by(self, bus: Learns) -> None:
        try:
            learnt, self.answers_s = bus.learnt(), bus.answers_s()
        except MemoryError:
            raise
        except Exception as error:  # noqa: BLE001 - likewise
            self.failed(self._wire, error)
            return
        for text in learnt:
            self._problems.tell(self._wire, text)

    def _shared_by(self, line: SharedLine) -> None:
        try:
            evidence = line.other_master()
        except MemoryError:
            raise
        except Exception as error:  # noqa: BLE001 - a driver's bug must not end the other buses
            self.failed(self._wire, error)
            return
        if evidence:
            self._problems.report(self._wire, Text(NoticeCode.OTHER_MASTER, bus=self._bus, evidence=evidence))
        else:
            self._problems.clear(self._wire, NoticeCode.NO_OTHER_MASTER, bus=self._bus)


def channel_bad(reading: Reading) -> Text:
    """Why a channel has no good value."""
    channel, quality, detail = reading.channel, reading.quality.value, reading.detail
    if detail:
        return Text(NoticeCode.CHANNEL_BAD_BECAUSE, channel=channel, quality=quality, detail=detail)
    return Text(NoticeCode.CHANNEL_BAD, channel=channel, quality=quality)
