"""A CAN interface with devices that send by themselves: the latest frame of each identifier somebody wants.

One thread of python-can's receives while connected; frames that nobody wants are dropped there.
"""

import asyncio
from collections.abc import Collection
from contextlib import suppress
from time import monotonic

import can

from drivers.base import ConnectError, NoAnswer
from drivers.bus_settings import CanSettings
from drivers.can_interface import open_interface, release
from drivers.tap import Tap

FrameId = tuple[int, bool]
"""Identifier, and whether it has 29 bits."""

_RECEIVE_WAIT_S = 0.1
"""How long closing may have to wait for the receiving thread."""


class CanBus:
    """Listens; sends nothing."""

    kind = "can"
    units = (1, 127)

    def __init__(self, name: str, settings: CanSettings, tap: Tap | None = None) -> None:
        self._name, self._settings, self._tap = name, settings, tap
        self._wanted: set[FrameId] = set()
        self._receiver: _Receiver | None = None

    @property
    def name(self) -> str:
        return self._name

    def want(self, frames: Collection[FrameId]) -> None:
        """Keep the latest of these frames from now on."""
        self._wanted |= set(frames)

    async def connect(self) -> None:
        """Open the interface; an open one stays. Raises ConnectError."""
        if self._receiver is not None:
            if self._receiver.lost is None:
                return
            await self.close()
        interface = await asyncio.to_thread(open_interface, self._name, self._settings, tap=self._tap)
        self._receiver = _Receiver(interface, self._wanted)

    async def close(self) -> None:
        receiver, self._receiver = self._receiver, None
        if receiver is not None:
            await asyncio.shield(asyncio.to_thread(receiver.end))

    async def latest(self, device: str, frames: Collection[FrameId]) -> dict[FrameId, bytes]:
        """The newest of these frames, none older than the timeout. Waits for those that are missing only until the
        interface has been open for that long: later they had their time, and waiting would cost other devices theirs.

        Raises NoAnswer when none came, or ConnectError.
        """
        receiver = self._receiver
        if receiver is None:
            raise ConnectError("not connected", bus=self._name, device=device, hint="connect the bus first")
        now = monotonic()
        oldest = now - self._settings.timeout_s
        with suppress(TimeoutError):
            async with asyncio.timeout(max(0.0, receiver.opened_s + self._settings.timeout_s - now)):
                while receiver.lost is None and len(receiver.since(oldest, frames)) < len(set(frames)):
                    await receiver.news()
        if receiver.lost is not None:
            raise ConnectError(
                f"interface {self._settings.channel} is gone: {receiver.lost}",
                bus=self._name,
                device=device,
                hint="connect the bus again",
            )
        found = receiver.since(oldest, frames)
        if not found:
            listed = ", ".join(f"0x{identifier:X}" for identifier, _ in sorted(frames))
            raise NoAnswer(
                f"none of the frames {listed} came within {self._settings.timeout_s:g} s",
                bus=self._name,
                device=device,
                hint="check power, termination, bitrate and identifiers; is timeout_s longer than the device's cycle?",
            )
        return found


class _Receiver(can.Listener):
    """Written by the receiving thread, read from the event loop; whole entries are replaced."""

    def __init__(self, interface: can.BusABC, wanted: set[FrameId]) -> None:
        self.lost: Exception | None = None
        self.opened_s = monotonic()
        self._latest: dict[FrameId, tuple[float, bytes]] = {}
        self._interface, self._wanted = interface, wanted
        self._loop, self._arrived = asyncio.get_running_loop(), asyncio.Event()
        self._notifier: can.Notifier | None = None
        self._notifier = can.Notifier(interface, [self], timeout=_RECEIVE_WAIT_S)

    def on_message_received(self, msg: can.Message) -> None:
        """In the receiving thread. Error and remote frames carry no value."""
        key = msg.arbitration_id, bool(msg.is_extended_id)
        if key in self._wanted and not (msg.is_error_frame or msg.is_remote_frame):
            self._latest[key] = monotonic(), bytes(msg.data)
            self._tell()

    def on_error(self, exc: Exception) -> None:
        """In the receiving thread: the interface failed; end it."""
        self.lost = exc
        if self._notifier is not None:
            self._notifier.stop(0.0)
        self._tell()

    def since(self, oldest: float, frames: Collection[FrameId]) -> dict[FrameId, bytes]:
        """Those of the frames that came since then."""
        kept = {key: self._latest[key] for key in frames if key in self._latest}
        return {key: data for key, (came, data) in kept.items() if came >= oldest}

    async def news(self) -> None:
        """Wait for a wanted frame, or for the end."""
        self._arrived.clear()
        await self._arrived.wait()

    def end(self) -> None:
        """End the thread and close the interface. Blocks."""
        with suppress(can.CanError, OSError):  # an unplugged adapter cannot be told anything any more
            if self._notifier is not None:
                self._notifier.stop(2.0)
            self._interface.shutdown()
        release(self._interface)

    def _tell(self) -> None:
        with suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(self._arrived.set)
