"""Publishes everything over Zenoh, from a thread of its own: the control loop never waits for the network."""

import asyncio
import json
import logging
import queue
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Self

import zenoh

from drivers.base import Clock, Reading
from gateway.config.sections import Telemetry as TelemetrySettings
from gateway.nc.slew import Write
from gateway.probing.cycle import Outcome
from gateway.probing.schedule import Outlook
from gateway.telemetry import keys
from talc.frame import Decision, Event, Frame
from talc.models import ModelSet
from talc.sensor_check import Judgement

log = logging.getLogger(__name__)

_QUEUE = 5000
_JSON = zenoh.Encoding.APPLICATION_JSON
_MUST_ARRIVE = frozenset({keys.FRAME, keys.DECISION, keys.MEASUREMENT, keys.MODEL, keys.EVENT, keys.PROBING})
"""Kinds for which a slow subscriber makes the publishing thread wait instead of losing a sample."""


class TelemetryError(OSError):
    """No session could be opened; the message names the endpoints and what to do."""


def session_config(settings: TelemetrySettings) -> zenoh.Config:
    """Zenoh's configuration: nothing is found by multicast unless asked for; absent peers are tried again for ever."""
    config = zenoh.Config()
    values: dict[str, object] = {
        "mode": settings.mode,
        "listen/endpoints": list(settings.listen),
        "connect/endpoints": list(settings.connect),
        "scouting/multicast/enabled": settings.multicast,
        "scouting/gossip/enabled": False,
        "timestamping/enabled": True,
    }
    if settings.mode == "peer":
        values["connect/exit_on_failure"] = False
    for key, value in values.items():
        config.insert_json5(key, json.dumps(value))
    return config


class Telemetry:
    """An Outlet that publishes. An async context manager.

    A late subscriber gets the last value of every key by a query on `<prefix>/<machine>/**`. When the network is slower
    than the readings, readings are dropped and counted; nothing else is.

    Parameters
    ----------
    settings: the [telemetry] section
    machine: second part of every key
    input_names: order of a frame's inputs
    clock: for the time in each payload and the age of readings
    boot: identifies this run of the process
    simulated: whether the clock is a simulated one

    Raises TelemetryError on entering when the session cannot be opened.
    """

    def __init__(
        self,
        settings: TelemetrySettings,
        machine: str,
        input_names: Sequence[str],
        clock: Clock,
        boot: str,
        *,
        simulated: bool,
    ) -> None:
        self._settings, self._root = settings, keys.root(settings.prefix, machine)
        self._names, self._clock, self._boot = tuple(input_names), clock, boot
        self._clock_state = "simulated" if simulated else "system"
        self._queue: queue.Queue[tuple[str, bytes] | None] = queue.Queue()
        self._outlook: Outlook | None = None
        self._sequence = 0
        self._dropped = 0
        self._decided: tuple[str | None, int | None] = None, None
        self._config: str | None = None
        self._periods_missed: Callable[[], Mapping[str, int]] = dict
        self._last: dict[str, bytes] = {}
        self._last_lock = threading.Lock()
        self._thread = threading.Thread(target=self._publish, name="telemetry", daemon=True)
        self._session: zenoh.Session | None = None

    @property
    def dropped(self) -> int:
        """Readings that were not published because the network was too slow."""
        return self._dropped

    async def __aenter__(self) -> Self:
        try:
            self._session = await asyncio.to_thread(zenoh.open, session_config(self._settings))
        except zenoh.ZError as error:
            where = ", ".join((*self._settings.listen, *self._settings.connect)) or "no endpoints"
            raise TelemetryError(
                f"telemetry: no Zenoh session on {where}: {str(error).split('  at ')[0]}. "
                "Is another program listening there?"
            ) from error
        self._queryable = self._session.declare_queryable(f"{self._root}/**", self._answer)
        self._token = self._session.liveliness().declare_token(f"{self._root}/{keys.ALIVE}")
        self._thread.start()
        return self

    async def __aexit__(self, *_: object) -> None:
        self._queue.put(None)
        await asyncio.to_thread(self._thread.join)
        if self._session is not None:
            await asyncio.to_thread(self._close, self._session)

    def _close(self, session: zenoh.Session) -> None:
        self._token.undeclare()
        self._queryable.undeclare()
        session.close()

    # Outlet ----------------------------------------------------------------------------------------------------------

    def readings(self, readings: Sequence[Reading]) -> None:
        if self._queue.qsize() > _QUEUE:
            self._dropped += len(readings)
            return
        now_s = self._clock.monotonic()
        for r in readings:
            self._put(f"{keys.READING}/{r.channel}", keys.reading(r, now_s))

    def frame(self, frame: Frame) -> None:
        self._put(keys.FRAME, keys.frame(frame, self._names))

    def decision(self, decision: Decision) -> None:
        self._put(keys.DECISION, keys.decision(decision))
        self._decided = decision.phase.value, decision.k
        self._put_status()

    def requested(self, number: int) -> None: ...

    def measurement(self, outcome: Outcome) -> None:
        self._put(keys.MEASUREMENT, keys.measurement(outcome))

    def models(self, models: ModelSet, after_k: int) -> None:
        for m in models.models:
            if m is not None:
                self._put(f"{keys.MODEL}/{m.error}", keys.model(m, after_k))

    def event(self, event: Event, k: int | None) -> None:
        self._put(keys.EVENT, keys.event(event, k))

    def compensation(self, write: Write) -> None:
        if write.mode != "monitor":
            self._put(keys.COMPENSATION, keys.compensation(write))

    def sensors(self, judgement: Judgement, k: int) -> None:
        self._put(keys.SENSORS, keys.sensors(judgement, k))

    def probing(self, outlook: Outlook) -> None:
        self._outlook = outlook
        self._put(keys.PROBING, keys.probing(outlook))
        self._put_status()

    def runs(self, fingerprint: str) -> None:
        """The configuration with this fingerprint runs from now on; call it after every change."""
        self._config = fingerprint
        self._put_status()

    def count_missed(self, periods_missed: Callable[[], Mapping[str, int]]) -> None:
        """Where the status gets the number of missed periods from, by bus."""
        self._periods_missed = periods_missed

    # Publishing ------------------------------------------------------------------------------------------------------

    def _put_status(self) -> None:
        phase, k = self._decided
        missed = self._periods_missed()
        self._put(keys.STATUS, keys.status(phase, k, self._dropped, missed, self._config, self._outlook))

    def _put(self, suffix: str, payload: keys.Payload) -> None:
        self._sequence += 1
        common = {
            "boot": self._boot,
            "seq": self._sequence,
            "time": self._clock.utc().isoformat(),
            "clock": self._clock_state,
        }
        self._queue.put((suffix, keys.encode(common | payload)))

    def _publish(self) -> None:
        session = self._session
        while session is not None and (item := self._queue.get()) is not None:
            suffix, payload = item
            must = suffix.split("/")[0] in _MUST_ARRIVE
            control = zenoh.CongestionControl.BLOCK if must else zenoh.CongestionControl.DROP
            with self._last_lock:
                self._last[suffix] = payload
            try:
                session.put(f"{self._root}/{suffix}", payload, encoding=_JSON, congestion_control=control)
            except zenoh.ZError as error:
                log.warning("telemetry: %s was not published: %s", suffix, error)

    def _answer(self, query: zenoh.Query) -> None:
        """Reply with the last value of every key asked for; called on a thread of Zenoh's."""
        with self._last_lock:
            last = dict(self._last)
        for suffix, payload in last.items():
            key = zenoh.KeyExpr(f"{self._root}/{suffix}")
            if query.key_expr.intersects(key):
                query.reply(key, payload, encoding=_JSON)
