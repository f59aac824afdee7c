"""The subscriptions that the emulated control's clients hold, with the ways in which they fail."""

from collections.abc import Callable
from typing import Any

from asyncua import ua
from asyncua.server.subscription_service import SubscriptionService
from asyncua.ua.uatypes import NodeId, StatusCode, UInt32


class Subscriptions(SubscriptionService):
    """The library's subscription service, which a test can make fail."""

    _silent = False

    async def create_subscription(
        self,
        params: ua.CreateSubscriptionParameters,
        callback: Callable[..., Any],
        session_id: NodeId,
        request_callback: Callable[..., Any] | None = None,
    ) -> ua.CreateSubscriptionResult:
        result = await super().create_subscription(params, callback, session_id, request_callback)
        if self._silent:
            await self.subscriptions[result.SubscriptionId].stop()
        return result

    async def fall_silent(self) -> None:
        """Publish nothing more, no sign of life either, also for subscriptions that clients make from now on."""
        self._silent = True
        for subscription in self.subscriptions.values():
            await subscription.stop()

    async def change_status(self, status: int) -> None:
        """Report a status, one of asyncua's StatusCodes, for every subscription; the signs of life go on."""
        for subscription in self.subscriptions.values():
            await subscription.monitored_item_srv.trigger_statuschange(StatusCode(UInt32(status)))
