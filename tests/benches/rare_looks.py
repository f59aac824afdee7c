"""Lets libraries and the gateway look less often for what nobody waits for, so that simulated time takes longer steps.

Simulated time costs some 0.4 ms a step, whatever happens in it. Of 15 steps in ten simulated seconds, 13 were looks: at
an empty port of the CAN adapter whether to go on waiting, at the store's disk, the health, the clock, at sessions that
may have expired, at subscriptions that do not exist. Frames, answers and faults end a wait at once, as before.
"""

import asyncio
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import partialmethod
from unittest.mock import patch

from asyncua.client.client import Client
from asyncua.server.binary_server_asyncio import BinaryServer
from asyncua.server.internal_session import InternalSession
from asyncua.server.uaprocessor import UaProcessor

from drivers.can import interface, receiver
from gateway import service
from gateway.storage import Store
from gateway.watches import clock, health

_CAN_WAIT_S = 300.0
"""Instead of 0.1 s: the port's own wait, which a byte, an unplugged adapter or the thread's stop ends."""
_LOOK_S = 100.0
"""Instead of 5 or 10 s, for the gateway's looks at itself: as often as the bench's buses are polled."""


async def _never(owner: object) -> None:
    """In place of OPC UA's looks, each half second to 15 s: at sessions that may have expired (no client of a soak
    leaves one behind, and those of a control that is switched off end with it), at subscriptions (there are none), at
    connections that are closed (awaited when the server stops).
    """
    del owner
    await asyncio.Event().wait()


@contextmanager
def rare_looks() -> Iterator[None]:
    """Inside, what is opened looks rarely: OPC UA's clients and servers, serial CAN adapters, and the gateway's watches
    of itself, with a grid step of 300 s.
    """
    stop = receiver.Receiver.stop

    def stop_at_once(self: receiver.Receiver) -> None:
        self._stopping.set()
        port = interface.serial_port(self._interface)
        if port is not None:
            port.cancel_read()
        stop(self)

    with ExitStack() as stack:
        for owner, name, value in (
            (receiver, "_WAIT_S", 0.0),  # so that one wait is one read of the port, which can be cancelled
            (interface, "_SERIAL_WAIT_S", _CAN_WAIT_S),
            (receiver.Receiver, "stop", stop_at_once),
            (health, "HEALTH_PERIOD_S", _LOOK_S),
            (clock, "_PERIOD_S", _LOOK_S),
            (service, "_SHORTEST_LOOK_S", _LOOK_S),
            (Store, "__init__", partialmethod(Store.__init__, look_s=_LOOK_S)),
            (Client, "_stale_watchdog_loop", _never),
            (UaProcessor, "_session_watchdog_loop", _never),
            (InternalSession, "_timeout_loop", _never),
            (BinaryServer, "_close_task_loop", _never),
        ):
            stack.enter_context(patch.object(owner, name, value))
        yield
