"""Lets libraries look less often for what nobody waits for, so that simulated time takes longer steps.

Simulated time costs some 0.4 ms a step, whatever happens in it. Of 13 steps in a simulated second, 12 were looks: at an
empty port of the CAN adapter whether to go on waiting, at a session whether it has expired, at subscriptions that do
not exist. Frames, answers and faults end a wait at once, as before.
"""

import asyncio
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any
from unittest.mock import patch

from asyncua.client.client import Client
from asyncua.server.uaprocessor import UaProcessor

from drivers.can import interface, receiver

_CAN_WAIT_S = 1.0
"""Instead of 0.1 s; closing waits for a receiving thread for 2 s."""
_SESSION_LOOK_S = 30.0
"""Instead of 1 s; no session of a soak expires, which takes an hour."""


async def _no_subscription_is_watched(client: Client) -> None:
    """In place of a look each half second: the gateway of a soak subscribes to nothing."""
    del client
    await asyncio.Event().wait()


@contextmanager
def rare_looks() -> Iterator[None]:
    """Inside, clients and servers of OPC UA and CAN adapters that are opened look rarely."""
    begin = UaProcessor.__init__

    def begin_rarely(self: UaProcessor, *given: Any, **named: Any) -> None:
        begin(self, *given, **named)
        self._watchdog_interval = _SESSION_LOOK_S

    with ExitStack() as stack:
        stack.enter_context(patch.object(receiver, "_WAIT_S", _CAN_WAIT_S))
        stack.enter_context(patch.object(interface, "_SERIAL_WAIT_S", _CAN_WAIT_S))
        stack.enter_context(patch.object(Client, "_stale_watchdog_loop", _no_subscription_is_watched))
        stack.enter_context(patch.object(UaProcessor, "__init__", begin_rarely))
        yield
