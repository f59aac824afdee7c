"""Subscriptions of the emulated control: values are computed when read, so this sampler looks for changes."""

import asyncio
from typing import Protocol

from asyncua import ua
from asyncua.common.callback import CallbackType, ServerItemCallback
from asyncua.server.server import Server
from asyncua.ua.attribute_ids import AttributeIds
from asyncua.ua.uatypes import DataValue, NodeId, StatusCode

_PERIOD_S = 0.05


class Sampling(Protocol):
    """Whether the control looks for changes."""

    @property
    def sampling(self) -> bool: ...


class Sampler:
    """Samples monitored nodes and reports changes; rests while no node is monitored."""

    def __init__(self, server: Server, namespace: int, control: Sampling) -> None:
        self._control = control
        self._aspace = server.iserver.aspace
        self._namespace = namespace
        self._seen: dict[NodeId, tuple[ua.Variant | None, StatusCode | None] | None] = {}
        self._wanted = asyncio.Event()
        server.subscribe_server_callback(CallbackType.ItemSubscriptionCreated, self._note)

    def _note(self, event: ServerItemCallback, _: object) -> None:
        for item in event.request_params.ItemsToCreate:
            if item.ItemToMonitor.NodeId.NamespaceIndex == self._namespace:
                self._seen.setdefault(item.ItemToMonitor.NodeId, None)
        self._wanted.set()

    async def run(self) -> None:
        """Run until cancelled."""
        while True:
            if not self._seen:
                self._wanted.clear()
            await self._wanted.wait()
            for node, before in list(self._seen.items()) if self._control.sampling else ():
                attribute = self._aspace[node].attributes[AttributeIds.Value]
                if not attribute.datachange_callbacks:
                    del self._seen[node]
                    continue
                value: DataValue = self._aspace.read_attribute_value(node, AttributeIds.Value)
                if (shown := (value.Value, value.StatusCode)) != before:
                    self._seen[node] = shown
                    for handle, report in list(attribute.datachange_callbacks.items()):
                        await report(handle, value)
            await asyncio.sleep(_PERIOD_S)
