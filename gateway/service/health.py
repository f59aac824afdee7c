"""Checks the gateway's health every 10 s: what is good, and what the gateway waits for."""

from collections.abc import Callable
from datetime import UTC, datetime

from drivers.base import Quality, Reading
from gateway.acquisition.board import Board
from gateway.model.control_state import NcState
from gateway.model.events import DecisionMade, GatewayEvent, Health, HealthChecked, OutlookChanged, Sink, StoreHealth
from gateway.model.standing import Standing
from gateway.nc.link import NcLink
from gateway.nc.probing.schedule import Outlook
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
    link: returns the connection to the control; None: none is configured
    store: its health
    synchronised: whether a time server keeps the clock; None: unknown
    sink: receives HealthChecked
    """

    def __init__(
        self,
        step_s: float,
        board: Board,
        link: Callable[[], NcLink | None],
        clock: ServiceClock,
        store: Callable[[], StoreHealth],
        synchronised: Callable[[], bool | None],
        sink: Sink,
    ) -> None:
        self._step_s, self._board, self._link, self._clock = step_s, board, link, clock
        self._store, self._synchronised, self._sink = store, synchronised, sink
        self._periodic = Periodic(clock, HEALTH_PERIOD_S)
        self._began_s: float | None = None
        self._outlook = Outlook(Standing.NOT_WANTED, None)
        self._decided = False

    def take(self, event: GatewayEvent) -> None:
        """A gateway.model.events.Sink: remembers whether something was decided and what a measurement waits for."""
        match event:
            case DecisionMade():
                self._decided = True
            case OutlookChanged(outlook):
                self._outlook = outlook
            case _:
                pass

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
        link = self._link()
        paused, disarmed = (None, None) if link is None else (link.paused, link.disarmed)
        return Health(
            uptime_s=now_s - self._began_s,
            channels=len(latest),
            channels_good=len(latest) - len(bad),
            nc=nc,
            clock_synchronised=synchronised,
            waits_for=(
                *((f"somebody to arm the gateway: {disarmed}",) if disarmed is not None else ()),
                *((f"somebody to resume the compensation: {paused}",) if paused is not None else ()),
                *self._first_step(),
                *_channels(bad),
                *_WAITS_FOR_NC.get(nc, ()),
                *_measurement(self._outlook),
                *((f"storage: {store.problem}",) if store.problem else ()),
                *(("the time: no time server keeps this computer's clock",) if synchronised is False else ()),
            ),
            store=store,
            paused=paused,
            disarmed=disarmed,
        )

    def _nc(self) -> NcState:
        link = self._link()
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

    def _first_step(self) -> tuple[str, ...]:
        if self._decided:
            return ()
        ends = datetime.fromtimestamp((self._clock.utc().timestamp() // self._step_s + 1) * self._step_s, UTC)
        return (f"the first decision: the grid step ends at {ends:%H:%M:%S} UTC",)


_WAITS_FOR_NC = {
    NcState.AWAY: ("the control: it cannot be reached",),
    NcState.STALE: ("the control: its axes report a speed and do not move",),
    NcState.NOT_READY: ("the control: it is not ready",),
}


def _good(reading: Reading) -> bool:
    return reading.quality.usable


def _channels(bad: dict[str, Reading | None]) -> tuple[str, ...]:
    texts = []
    for channel, reading in list(bad.items())[:_MOST_CHANNELS]:
        if reading is None:
            texts.append(f"channel {channel}: no reading yet")
        else:
            detail = f": {reading.detail}" if reading.detail else ""
            texts.append(f"channel {channel}: {reading.quality.value}{detail}")
    more = len(bad) - len(texts)
    return (*texts, *((f"{more} more channels",) if more else ()))


def _measurement(outlook: Outlook) -> tuple[str, ...]:
    texts = []
    if outlook.standing is not Standing.NOT_WANTED:
        why = "" if outlook.why is None else f" ({outlook.why.value})"
        reason = f": {outlook.reason}" if outlook.reason else ""
        texts.append(f"a measurement{why}: {outlook.standing.value}{reason}")
    if outlook.operator:
        texts.append(f"an operator: {outlook.operator}")
    return tuple(texts)
