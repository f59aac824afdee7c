"""A CAN interface with CANopen nodes. The canopen library blocks, so it lives in threads that this bus owns and joins.

Two threads while connected: one receives, one asks. Nothing of the library is touched from the event loop.
"""

import asyncio
import logging
import queue
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from time import monotonic
from typing import Any, TypeVar

import can
import canopen
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from drivers.base import BadAnswer, ConnectError, DriverError, NoAnswer, Refused
from drivers.bus_settings import CanOpenSettings
from drivers.can_interface import open_interface, release
from drivers.canopen_events import NodeEvents

R = TypeVar("R")

_SYNC = 0x080
_NMT_START = 1

_RECEIVE_WAIT_S = 0.1
"""How long closing may have to wait for the receiving thread."""

logging.getLogger("canopen").setLevel(logging.CRITICAL)  # what it logs, we raise


@dataclass(frozen=True, slots=True)
class CanObject:
    """One entry of a node's object dictionary."""

    index: int
    subindex: int

    def __str__(self) -> str:
        return f"{self.index:04X}:{self.subindex:02X}"


class CanOpenBus:
    """Nodes on one CAN interface. Reads of all nodes queue up in one thread."""

    kind = "canopen"
    units = (1, 127)

    def __init__(self, name: str, settings: CanOpenSettings) -> None:
        self._name, self._settings = name, settings
        self._network: Any = None
        self._thread: ThreadPoolExecutor | None = None
        self._doubtful: set[int] = set()
        self._events: dict[int, NodeEvents] = {}

    @property
    def name(self) -> str:
        return self._name

    async def connect(self) -> None:
        """Open the interface; an open one stays. Raises ConnectError."""
        if self._thread is not None:
            if self._network is not None and self._network.notifier.exception is None:
                return
            await self.close()
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix=f"canopen {self._name}")
        try:
            await self._in_thread(self._open)
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        if self._thread is None:
            return
        thread, self._thread = self._thread, None
        try:
            await asyncio.shield(asyncio.get_running_loop().run_in_executor(thread, self._shut))
        except asyncio.CancelledError:
            thread.shutdown(wait=False)  # it ends as soon as the interface is closed
            raise
        thread.shutdown(wait=True)

    async def upload(self, device: str, node: int, objects: Sequence[CanObject]) -> list[bytes]:
        """Read objects of one node by SDO, little-endian bytes each.

        Raises NoAnswer, BadAnswer, Refused (SDO abort) or ConnectError (interface gone).
        """
        return await self._in_thread(lambda: self._upload(device, node, objects))

    async def start_node(self, device: str, node: int) -> None:
        """Make the node operational (NMT), so that it sends PDOs. Raises ConnectError."""
        await self._in_thread(lambda: self._send(device, 0, bytes((_NMT_START, node))))

    async def synchronise(self, device: str, node: int, identifiers: Sequence[int]) -> dict[int, bytes]:
        """Send SYNC and wait for these TPDOs of the node. Raises NoAnswer or ConnectError."""
        return await self._in_thread(lambda: self._synchronise(device, node, identifiers))

    def events(self, node: int) -> NodeEvents:
        """What the node says unasked, since its first upload on this connection."""
        return self._events.setdefault(node, NodeEvents())

    async def _in_thread(self, work: Callable[[], R]) -> R:
        """Run in the bus's thread; whoever stops waiting does not stop the work, so no answer is left unread."""
        if self._thread is None:
            raise ConnectError("not connected", bus=self._name, hint="connect the bus first")
        future = asyncio.get_running_loop().run_in_executor(self._thread, work)
        future.add_done_callback(lambda done: done.cancelled() or done.exception())
        return await asyncio.shield(future)

    def _open(self) -> None:
        interface = open_interface(self._name, self._settings)
        network = canopen.Network(interface)
        network.NOTIFIER_CYCLE = _RECEIVE_WAIT_S
        network.listeners.append(_EndOnError(network))  # type: ignore[arg-type]
        network.connect()
        self._network = network
        self._doubtful.clear()

    def _shut(self) -> None:
        network, self._network = self._network, None
        if network is not None:
            interface = network.bus
            with suppress(can.CanError, OSError):  # an unplugged adapter cannot be told anything any more
                network.disconnect()
            if interface is not None and network.bus is not None:
                release(interface)

    def _upload(self, device: str, node: int, objects: Sequence[CanObject]) -> list[bytes]:
        if self._network is None:
            raise ConnectError("not connected", bus=self._name, device=device)
        if node not in self._network:
            dictionary = canopen.ObjectDictionary()  # type: ignore[no-untyped-call]
            self._network.add_node(canopen.RemoteNode(node, dictionary))
            remote = self._network[node]
            # The library keeps every emergency for ever; a node in trouble must not fill the memory.
            self._network.unsubscribe(0x80 + node, remote.emcy.on_emcy)
            self._network.subscribe(0x80 + node, self.events(node).on_emergency)
            self._network.subscribe(0x700 + node, self.events(node).on_heartbeat)
        sdo = self._network[node].sdo
        sdo.RESPONSE_TIMEOUT = self._settings.timeout_s
        if node in self._doubtful:
            # The late answer may still come. This object is never a value, and the node answers in order.
            self._one(sdo, device, node, CanObject(0x1000, 0))
            self._doubtful.discard(node)
        return [self._one(sdo, device, node, wanted) for wanted in objects]

    def _synchronise(self, device: str, node: int, identifiers: Sequence[int]) -> dict[int, bytes]:
        if node in self._doubtful:
            self._upload(device, node, ())  # frames of an earlier SYNC are before this answer
        frames: queue.SimpleQueue[tuple[int, bytes]] = queue.SimpleQueue()

        def put(identifier: int, data: bytes | bytearray, _: float) -> None:
            frames.put((identifier, bytes(data)))

        if self._network is None:
            raise ConnectError("not connected", bus=self._name, device=device)
        for identifier in identifiers:
            self._network.subscribe(identifier, put)
        try:
            self._send(device, _SYNC, b"")
            deadline = monotonic() + self._settings.timeout_s
            found: dict[int, bytes] = {}
            while missing := set(identifiers) - set(found):
                try:
                    identifier, data = frames.get(timeout=max(0.0, deadline - monotonic()))
                except queue.Empty:
                    listed = ", ".join(f"0x{identifier:03X}" for identifier in sorted(missing))
                    raise self._silence(device, node, f"TPDO {listed} did not come after SYNC") from None
                found[identifier] = data
            return found
        finally:
            for identifier in identifiers:
                self._network.unsubscribe(identifier, put)

    def _send(self, device: str, identifier: int, data: bytes) -> None:
        if self._network is None:
            raise ConnectError("not connected", bus=self._name, device=device)
        try:
            self._network.send_message(identifier, data)
        except (can.CanError, OSError) as error:
            raise self._lost(device, error) from error

    def _one(self, sdo: Any, device: str, node: int, wanted: CanObject) -> bytes:
        try:
            return bytes(sdo.upload(wanted.index, wanted.subindex))
        except SdoAbortedError as error:
            raise Refused(
                f"node {node} refused object {wanted}: {error}",
                bus=self._name,
                device=device,
                hint="does the profile fit the device?",
            ) from error
        except SdoCommunicationError as error:
            raise self._communication(device, node, wanted, error) from error
        except (can.CanError, OSError) as error:
            raise self._lost(device, error) from error

    def _lost(self, device: str, error: Exception) -> ConnectError:
        return ConnectError(
            f"interface {self._settings.channel} is gone: {error}",
            bus=self._name,
            device=device,
            hint="connect the bus again",
        )

    def _communication(self, device: str, node: int, wanted: CanObject, error: Exception) -> DriverError:
        if "No SDO response" in str(error):
            return self._silence(device, node, "no answer")
        self._doubtful.add(node)
        return BadAnswer(f"node {node}, object {wanted}: {error}", bus=self._name, device=device)

    def _silence(self, device: str, node: int, what: str) -> DriverError:
        self._doubtful.add(node)
        if (lost := self._network.notifier.exception) is not None:
            return self._lost(device, lost)
        return NoAnswer(
            f"node {node}: {what} within {self._settings.timeout_s:g} s",
            bus=self._name,
            device=device,
            hint="check power, termination (60 ohm between CAN_H and CAN_L), node id and bitrate",
        )


class _EndOnError(can.Listener):
    """Ends the receiving thread when the interface fails; python-can would print a traceback or try for ever."""

    def __init__(self, network: Any) -> None:
        self._network = network

    def on_message_received(self, msg: can.Message) -> None:
        """The network has its own listener."""

    def on_error(self, exc: Exception) -> None:  # noqa: ARG002 - python-can keeps it in Notifier.exception
        if self._network.notifier is not None:
            self._network.notifier.stop(0.0)
