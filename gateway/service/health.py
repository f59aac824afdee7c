"""Checks the gateway's health every 10 s: what is good, and what the gateway waits for."""

from collections.abc import Callable
from datetime import UTC, datetime

from drivers.base import Quality, Reading
from gateway.acquisition.board import Board
from gateway.acquisition.reports import channel_bad
from gateway.model.codes import NoticeCode
from gateway.model.connection import Connection
from gateway.model.control_state import NcState
from gateway.model.events import DecisionMade, Health, HealthChecked, OutlookChanged, Sink, StoreHealth
from gateway.model.probing import Outlook
from gateway.model.standing import Standing
from gateway.model.text import Text
from gateway.nc.link import NcLink
from gateway.runtime.clocks import ServiceClock
from gateway.runtime.periodic import Periodic

HEALTH_PERIOD_S = 10.0
_MOST_CHANNELS = 5
"""Channels that are named in what the gateway waits for; of the others only their number."""


class HealthWatch:
    """Reports the health once per period. It reads nothing but memory.

    Parameters
    ----------
    step_s: the grid step, s
    board: the latest readings
    link: the connection to the control; None: none is configured
    store: its health
    synchronised: whether a time server keeps the clock; None: unknown
    sink: receives HealthChecked
    telemetry: how it is connected; None: it is off
    machine: its name
    """

    def __init__(
        self,
        step_s: float,
        board: Board,
        link: NcLink | None,
        clock: ServiceClock,
        store: Callable[[], StoreHealth],
        synchronised: Callable[[], bool | None],
        sink: Sink,
        telemetry: Callable[[], Connection | None] = lambda: None,
        machine: str = "",
    ) -> None:
        self._step_s, self._board, self._link, self._clock = step_s, board, link, clock
        self._store, self._synchronised, self._sink, self._telemetry = store, synchronised, sink, telemetry
        self._machine = machine
        self._periodic = Periodic(clock, HEALTH_PERIOD_S)
        self._began_s: float | None = None
        self._outlook = Outlook(Standing.NOT_WANTED, None)
        self._decided = False

    def decided(self, _: DecisionMade) -> None:
        """Something was decided: the first step has ended."""
        self._decided = True

    def outlook_changed(self, changed: OutlookChanged) -> None:
        """Remembers what a measurement waits for."""
        self._outlook = changed.outlook

    async def run(self) -> None:
        """Run until cancelled."""
        await self._periodic.run(self._look)

    async def _look(self, _: float) -> None:
        self.report()

    def report(self) -> None:
        """Report it now, as after a change that somebody waits to see."""
        self._sink(HealthChecked(self.health()))

    def health(self) -> Health:
        """As it is now."""
        now_s = self._clock.monotonic()
        if self._began_s is None:
            self._began_s = now_s
        found = self._board.snapshot(now_s)
        latest = {channel: found[channel].reading if channel in found else None for channel in self._board.channels}
        bad = {channel: reading for channel, reading in latest.items() if reading is None or not _good(reading)}
        nc, store, synchronised = self._nc(), self._store(), self._synchronised()
        link, telemetry = self._link, self._telemetry()
        paused, disarmed = (None, None) if link is None else (link.paused, link.disarmed)
        return Health(
            uptime_s=now_s - self._began_s,
            channels=len(latest),
            channels_good=len(latest) - len(bad),
            nc=nc,
            clock_synchronised=synchronised,
            waits_for=(
                *((Text(NoticeCode.WAITS_ARM, order=disarmed.text),) if disarmed is not None else ()),
                *((Text(NoticeCode.WAITS_RESUME, order=paused.text),) if paused is not None else ()),
                *self._first_step(),
                *_channels(bad),
                *_WAITS_FOR_NC.get(nc, ()),
                *_measurement(self._outlook),
                *((Text(NoticeCode.WAITS_STORAGE, problem=store.problem),) if store.problem else ()),
                *((Text(NoticeCode.WAITS_TIME_SERVER),) if synchronised is False else ()),
                *_others(telemetry, self._machine),
            ),
            store=store,
            paused=paused,
            disarmed=disarmed,
            telemetry=telemetry,
        )

    def _nc(self) -> NcState:
        link = self._link
        if link is None:
            return NcState.NONE
        present = link.present
        if present is None:
            return NcState.AWAY
        if present.quality is Quality.STALE:
            return NcState.STALE
        if present.ready is False:
            return NcState.NOT_READY
        return NcState.PROBING if present.probing else NcState.READY

    def _first_step(self) -> tuple[Text, ...]:
        if self._decided:
            return ()
        ends = datetime.fromtimestamp((self._clock.utc().timestamp() // self._step_s + 1) * self._step_s, UTC)
        return (Text(NoticeCode.WAITS_FIRST_STEP, ends=ends),)


_WAITS_FOR_NC = {
    NcState.AWAY: (Text(NoticeCode.WAITS_NC_AWAY),),
    NcState.STALE: (Text(NoticeCode.WAITS_NC_STILL),),
    NcState.NOT_READY: (Text(NoticeCode.WAITS_NC_NOT_READY),),
}


def _good(reading: Reading) -> bool:
    return reading.quality.usable


def _channels(bad: dict[str, Reading | None]) -> tuple[Text, ...]:
    texts = [
        Text(NoticeCode.NO_READING_YET, channel=channel) if reading is None else channel_bad(reading)
        for channel, reading in list(bad.items())[:_MOST_CHANNELS]
    ]
    more = len(bad) - len(texts)
    return (*texts, *((Text(NoticeCode.MORE_CHANNELS, n=more),) if more else ()))


def _others(telemetry: Connection | None, machine: str) -> tuple[Text, ...]:
    """What keeps the others from hearing the gateway."""
    if telemetry is None:
        return ()
    found = []
    if telemetry.problem:
        found.append(Text(NoticeCode.WAITS_TELEMETRY, since=telemetry.since, problem=telemetry.problem))
    if telemetry.confirmed is False:
        found.append(Text(NoticeCode.TELEMETRY_UNCONFIRMED, to=telemetry.to, machine=machine))
    if telemetry.other:
        found.append(Text(NoticeCode.TWO_OF_ONE_NAME, machine=machine, other=telemetry.other))
    return tuple(found)


def _measurement(outlook: Outlook) -> tuple[Text, ...]:
    texts = []
    standing = outlook.standing
    if standing is not Standing.NOT_WANTED:
        if outlook.why is None:
            texts.append(Text(NoticeCode.WAITS_ASKED, standing=standing.value))
        elif outlook.reason:
            texts.append(
                Text(
                    NoticeCode.WAITS_MEASUREMENT_BECAUSE,
                    why=outlook.why.value,
                    standing=standing.value,
                    reason=outlook.reason,
                )
            )
        else:
            texts.append(Text(NoticeCode.WAITS_MEASUREMENT, why=outlook.why.value, standing=standing.value))
    if outlook.operator:
        texts.append(Text(NoticeCode.WAITS_OPERATOR, message=outlook.operator))
    return tuple(texts)
