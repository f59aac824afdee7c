"""Makes libraries and the gateway look less often for what nobody waits for, so that simulated time takes longer steps.

Simulated time costs some 0.4 ms a step, whatever happens in it. Of 15 steps in ten simulated seconds, 13 were looks: at
an empty port of the CAN adapter whether to go on waiting, at the store's disk, the health, the clock, at sessions that
may have expired, at subscriptions that do not exist. Frames, answers and faults end a wait at once, as before.
"""

from contextlib import AbstractContextManager

from asyncua.client import client
from asyncua.server import binary_server_asyncio, internal_session, uaprocessor

from drivers.can import interface, receiver
from gateway import service
from gateway.storage import store
from gateway.watches import clock, health
from tests.benches.changed_source import SourceChange, changed

_LOOK_S = 100.0
"""Instead of 5 or 10 s, for the gateway's looks at itself: as often as the bench's buses are polled."""
_FOR_EVER = "await asyncio.Event().wait()"
"""In place of OPC UA's looks, each half second to 15 s: at sessions that may have expired (no client of a soak leaves
one behind, and those of a control that is switched off end with it), at subscriptions (there are none), at connections
that are closed (awaited when the server stops)."""

_CHANGES = (
    # The port's own wait instead of 0.1 s: one wait is one read of it, which a byte, an unplugged adapter or the
    # thread's stop ends.
    SourceChange(interface, '"timeout": _SERIAL_WAIT_S', '"timeout": 300.0'),
    SourceChange(receiver, "recv(_WAIT_S)", "recv(0.0)"),
    SourceChange(
        receiver,
        """\
        self._stopping.set()
""",
        """\
        from drivers.can.interface import serial_port
        self._stopping.set()
        if (port := serial_port(self._interface)) is not None:
            port.cancel_read()
""",
    ),
    SourceChange(health, "Periodic(clock, HEALTH_PERIOD_S)", f"Periodic(clock, {_LOOK_S})"),
    SourceChange(clock, "Problems(clock, _PERIOD_S, notify, log)", f"Problems(clock, {_LOOK_S}, notify, log)"),
    SourceChange(clock, "Periodic(self._clock, _PERIOD_S)", f"Periodic(self._clock, {_LOOK_S})"),
    SourceChange(service, "max(_SHORTEST_LOOK_S, ", f"max({_LOOK_S}, "),
    SourceChange(store, "look_s=look_s", f"look_s={_LOOK_S}"),
    SourceChange(client, "await asyncio.sleep(self._stale_check_interval)", _FOR_EVER),
    SourceChange(uaprocessor, "await asyncio.sleep(timeout)", _FOR_EVER),
    SourceChange(internal_session, "await asyncio.sleep(min(remaining, max(timeout / 4, 0.1)))", _FOR_EVER),
    SourceChange(binary_server_asyncio, "await asyncio.sleep(10)", _FOR_EVER),
)


def rare_looks() -> AbstractContextManager[None]:
    """Inside, whatever is opened looks rarely: OPC UA's clients and servers, serial CAN adapters, and the gateway's
    watches of itself, with a grid step of 300 s.
    """
    return changed(_CHANGES)
