"""A CAN bus with devices that send without being asked. It keeps the latest frame of each subscribed identifier.

While connected, one thread receives; it drops frames without a subscription.
"""

import asyncio
from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass
from time import monotonic

import can

from drivers.base import ConnectError, NoAnswer
from drivers.can.interface import interface_error, open_interface, shut
from drivers.can.receiver import Receiver
from drivers.can.settings import CanSettings
from drivers.can.wanted import FrameId, WantedFrame
from drivers.tap import Tap
from drivers.text import Text


@dataclass(frozen=True, slots=True)
class KeptFrame:
    """The latest of some frames."""

    came_s: float
    """Monotonic."""
    data: bytes


class CanBus:
    """A bus that listens and sends nothing."""

    kind = CanSettings.bus_kind
    units = CanSettings.units

    def __init__(self, name: str, settings: CanSettings, tap: Tap | None = None) -> None:
        self.name, self.timeout_s = name, settings.timeout_s
        self._settings, self._tap = settings, tap
        self._wanted: dict[FrameId, set[WantedFrame]] = {}
        self._ears: _Ears | None = None

    def want(self, frames: Collection[WantedFrame]) -> None:
        """Keep the latest of each of these frames from now on."""
        for frame in frames:
            key = frame.identifier, frame.extended
            self._wanted[key] = self._wanted.get(key, set()) | {frame}  # replaced whole: the receiving thread reads it

    async def connect(self) -> None:
        """Open the interface, unless it is already open. Raises ConnectError."""
        if self._ears is not None:
            if self._ears.lost is None:
                return
            await self.close()
        interface = await asyncio.to_thread(open_interface, self.name, self._settings, tap=self._tap)
        self._ears = _Ears(interface, self._wanted)

    async def close(self) -> None:
        ears, self._ears = self._ears, None
        if ears is not None:
            await asyncio.shield(asyncio.to_thread(ears.end))

    async def latest(self, device: str, frames: Collection[WantedFrame]) -> dict[WantedFrame, KeptFrame]:
        """The newest of these frames, none older than the timeout. Waits for missing ones only until the interface has
        been open for that long: after that they have had their time, and waiting would delay other devices.

        Raises NoAnswer when none came, or ConnectError.
        """
        ears = self._ears
        if ears is None:
            raise ConnectError(Text("not_connected"), bus=self.name, device=device, hint=Text("connect_bus_first"))
        now = monotonic()
        oldest = now - self._settings.timeout_s
        with suppress(TimeoutError):
            async with asyncio.timeout(max(0.0, ears.opened_s + self._settings.timeout_s - now)):
                while ears.lost is None and len(ears.since(oldest, frames)) < len(set(frames)):
                    await ears.news()
        if ears.lost is not None:
            raise interface_error(self.name, device, self._settings, ears.lost)
        found = ears.since(oldest, frames)
        if not found:
            listed = ", ".join(f"0x{identifier:X}" for identifier in sorted({frame.identifier for frame in frames}))
            raise NoAnswer(
                Text("can_no_frames", listed=listed, timeout_s=self._settings.timeout_s),
                bus=self.name,
                device=device,
                hint=Text("can_check"),
            )
        return found


class _Ears:
    """Frames written by the receiving thread and read from the event loop; entries are replaced whole."""

    def __init__(self, interface: can.BusABC, wanted: Mapping[FrameId, Collection[WantedFrame]]) -> None:
        self.opened_s = monotonic()
        self._latest: dict[WantedFrame, KeptFrame] = {}
        self._interface, self._wanted = interface, wanted
        self._loop, self._arrived = asyncio.get_running_loop(), asyncio.Event()
        self._receiver = Receiver(interface, self._hear, self._tell)

    @property
    def lost(self) -> Exception | None:
        """Why the interface failed."""
        return self._receiver.exception

    def since(self, oldest: float, frames: Collection[WantedFrame]) -> dict[WantedFrame, KeptFrame]:
        """Those of the frames that came since then."""
        kept = {key: self._latest[key] for key in frames if key in self._latest}
        return {key: frame for key, frame in kept.items() if frame.came_s >= oldest}

    async def news(self) -> None:
        """Wait for a subscribed frame, or for the end."""
        self._arrived.clear()
        await self._arrived.wait()

    def end(self) -> None:
        """End the thread and close the interface. Blocks."""
        self._receiver.stop()
        shut(self._interface)

    def _hear(self, message: can.Message) -> None:
        """Runs in the receiving thread. Error and remote frames carry no value."""
        key = message.arbitration_id, bool(message.is_extended_id)
        if key not in self._wanted or message.is_error_frame or message.is_remote_frame:
            return
        data, now_s = bytes(message.data), monotonic()
        for wanted in self._wanted[key]:
            if wanted.fits(data):
                self._latest[wanted] = KeptFrame(now_s, data)
        self._tell()

    def _tell(self) -> None:
        """Runs in the receiving thread."""
        with suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(self._arrived.set)
