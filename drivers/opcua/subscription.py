"""One subscription to an OPC UA server: the reported values, and whether it is alive."""

import math
from collections.abc import Sequence

from asyncua import ua
from asyncua.client.client import Client
from asyncua.client.ua_client import UaClientState
from asyncua.common import subscription
from asyncua.common.node import Node
from asyncua.ua.uaerrors import UaStatusCodeError
from asyncua.ua.uatypes import DataValue, NodeId

_KEEP_ALIVE_S = 1.0
_MARGIN = 2.5
"""Keep-alives that may be missed before the subscription is considered silent."""


class Subscription:
    """The latest value of every subscribed node.

    Parameters
    ----------
    client: an open session
    nodes: what to subscribe to
    interval_s: how often the server may report changes
    """

    def __init__(self, client: Client, nodes: Sequence[NodeId], interval_s: float) -> None:
        self._client = client
        self._nodes = tuple(nodes)
        self._interval_s = interval_s
        self._values: dict[NodeId, DataValue] = {}
        self._subscription: subscription.Subscription | None = None
        self._number: int | None = None
        """Number of the server's subscription that the values come from."""

    async def start(self) -> bool:
        """Subscribe to all nodes; False when the server offers no subscription or refuses one of the nodes."""
        interval = ua.Duration(self._interval_s * 1e3)
        wanted = ua.CreateSubscriptionParameters(
            RequestedPublishingInterval=interval,
            RequestedLifetimeCount=ua.Counter(10_000),
            RequestedMaxKeepAliveCount=ua.Counter(max(1, math.ceil(_KEEP_ALIVE_S / self._interval_s))),
            MaxNotificationsPerPublish=ua.Counter(10_000),
            PublishingEnabled=True,
        )
        try:
            self._subscription = await self._client.create_subscription(wanted, self)
            items = await self._subscription.subscribe_data_change(
                [self._client.get_node(node) for node in self._nodes], queuesize=1, sampling_interval=interval
            )
        except UaStatusCodeError:
            return False
        return all(isinstance(item, int) for item in items)

    def datachange_notification(self, node: Node, _value: object, data: subscription.DataChangeNotif) -> None:
        """The methods that the library calls."""
        self._forget_the_one_before()
        self._values[node.nodeid] = data.monitored_item.Value

    def status_change_notification(self, _status: ua.StatusChangeNotification) -> None:
        """The subscription has ended or moved: earlier values no longer count."""
        self._values.clear()

    def latest(self) -> list[DataValue] | None:
        """One value per node; None while some are missing or after the server has gone silent."""
        if self._client.state is not UaClientState.CONNECTED or self._subscription is None:
            return None
        self._forget_the_one_before()
        if self._subscription.is_stale(_MARGIN) or len(self._values) < len(self._nodes):
            return None
        return [self._values[node] for node in self._nodes]

    def _forget_the_one_before(self) -> None:
        """The library replaces a subscription that has gone silent and then counts it as alive: until the new one has
        reported every node, no value is known."""
        number = self._subscription.subscription_id if self._subscription is not None else None
        if number != self._number:
            self._values.clear()
            self._number = number
