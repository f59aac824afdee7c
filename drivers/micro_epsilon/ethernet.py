"""Micro-Epsilon controllers on Ethernet. The data port sends a stream of blocks, each with a header.

Little-endian: "MEAS", order number, serial number (u32), u64 channel field (2 bits a channel), u32 status, u16 frames,
u16 bytes per frame, u32 counter, then frames of one int32 per channel. The manual of the capaNCDT 6200 (6.2) says of
the status: "Is not used", so nothing is read from it.
"""

import asyncio
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from drivers.base import BadAnswer, Clock, DriverError, NoAnswer, Reading, WrongDevice
from drivers.byte_stream import StreamBus, TcpStream
from drivers.micro_epsilon.profile import MeEthernetProfile
from drivers.micro_epsilon.scaling import Renewal, counted_um
from drivers.micro_epsilon.settings import DisplacementOptions, MeEthernetSettings
from drivers.readings import ReadingMaker
from drivers.tap import Tap
from drivers.text import Text

_START = b"MEAS"
_HEADER = struct.Struct("<4sIIQIHHI")
_NAME_SIZE = 12
"""Bytes of MEAS, order and serial number, with which every block of one controller begins."""
_MOST_CHANNELS = 32
_LONGEST_BLOCK = 65536


@dataclass(frozen=True, slots=True)
class MeBlock:
    """The newest frame of one block."""

    order: int
    serial: int
    counter: int
    values: Mapping[int, int]
    """Channel, counted from 0, to raw value; fitted channels only."""


class MeEthernetBus(StreamBus):
    """The data port of one controller."""

    kind = MeEthernetSettings.bus_kind
    units = MeEthernetSettings.units

    def __init__(self, name: str, settings: MeEthernetSettings, tap: Tap | None = None) -> None:
        super().__init__(name, TcpStream(name, settings.host, settings.port, tap), settings.timeout_s)

    async def next_block(self, device: str) -> MeBlock:
        """The next block that arrives whole; earlier bytes are old and discarded.

        Raises NoAnswer, BadAnswer or ConnectError.
        """
        async with self._lock:
            self._stream.discard()
            heard = bytearray()
            loop = asyncio.get_running_loop()
            deadline = loop.time() + self._timeout_s
            try:
                while (block := find_block(heard)) is None:
                    heard += await self._stream.read(deadline - loop.time())
                    del heard[: -2 * _LONGEST_BLOCK]
            except TimeoutError:
                raise self._nothing_valid(device, heard) from None
            return block

    def _nothing_valid(self, device: str, heard: bytearray) -> DriverError:
        if not heard:
            return NoAnswer(
                Text("me_no_values", timeout_s=self._timeout_s),
                bus=self._name,
                device=device,
                hint=Text("me_measuring"),
            )
        return BadAnswer(
            Text("me_no_block", count=len(heard), bytes=heard[:16].hex(" ")),
            bus=self._name,
            device=device,
            hint=Text("me_data_port"),
        )


class MeEthernetDevice:
    """A controller; `channels` maps names to its channels, counted from 0."""

    def __init__(
        self,
        device: str,
        bus: MeEthernetBus,
        profile: MeEthernetProfile,
        channels: Mapping[str, int],
        options: DisplacementOptions,
        clock: Clock,
    ) -> None:
        self.device, self.channels = device, tuple(channels)
        self._bus, self._profile, self._options = bus, profile, options
        self._channels = dict(channels)
        self._known: tuple[int, int] | None = None
        """Order and serial number of the first block: a new connection does not make it another controller."""
        self._renewal = Renewal()
        self._maker = ReadingMaker(dict.fromkeys(channels, profile.unit), clock)

    async def connect(self) -> None:
        """Check that it is the controller of the first connection and that the channels in use are fitted.

        Raises WrongDevice, or the bus's errors.
        """
        block = await self._block()
        # It may have stood still before this connection.
        self._renewal.fault(block.counter, tuple(block.values.items()))

    async def read(self, *, again: bool = False) -> Sequence[Reading]:  # noqa: ARG002
        """One reading per channel, in µm, from the next block. Raises as `connect`."""
        block = await self._block()
        same = self._renewal.fault(block.counter, tuple(block.values.items()))
        return self._maker.make(
            {
                name: same or counted_um(block.values[i], self._profile.value, self._options)
                for name, i in self._channels.items()
            }
        )

    async def close(self) -> None:
        """Nothing to close: the bus owns the connection."""

    async def _block(self) -> MeBlock:
        block = await self._bus.next_block(self.device)
        order, serial = self._known = self._known or (block.order, block.serial)
        if (order, serial) != (block.order, block.serial):
            raise WrongDevice(
                Text(
                    "me_other_controller",
                    order=block.order,
                    serial=block.serial,
                    wanted_order=order,
                    wanted_serial=serial,
                ),
                bus=self._bus.name,
                device=self.device,
                hint=Text("me_exchanged"),
            )
        for channel, number in self._channels.items():
            if number not in block.values:
                fitted = ", ".join(map(str, block.values)) or "none"
                raise WrongDevice(
                    Text("me_no_channel", order=block.order, serial=block.serial, number=number),
                    bus=self._bus.name,
                    device=self.device,
                    channel=channel,
                    hint=Text("me_fitted", fitted=fitted),
                )
        return block


def find_block(heard: bytes | bytearray) -> MeBlock | None:
    """The last complete block in `heard`, or None.

    Blocks have no checksum, so a block counts only when nothing or the next block follows it. This rejects the word
    MEAS among the values of another block, and a block that lost bytes and would be completed with those of the next.
    Until the next block has begun, a block that ends like the beginning of a header does not count either.
    """
    found = None
    start = 0
    while (start := heard.find(_START, start)) >= 0:
        block = _block_at(heard, start)
        if block is None:
            start += 1
        else:
            found, size = block
            start += size
    return found


def _block_at(heard: bytes | bytearray, start: int) -> tuple[MeBlock, int] | None:
    if len(heard) < start + _HEADER.size:
        return None
    _, order, serial, field, _status, frames, frame_size, counter = _HEADER.unpack_from(heard, start)
    fitted = [channel for channel in range(_MOST_CHANNELS) if field >> 2 * channel & 3]
    size = _HEADER.size + frames * frame_size
    end = start + size
    if not fitted or not frames or frame_size != 4 * len(fitted) or len(heard) < end:
        return None
    following = heard[end : end + len(_START)]
    if not _START.startswith(following):
        return None
    if len(following) < len(_START) and _another_begins(bytes(heard[start:end])):
        return None
    newest = struct.unpack_from(f"<{len(fitted)}i", heard, end - frame_size)
    return MeBlock(order, serial, counter, dict(zip(fitted, newest, strict=True))), size


def _another_begins(block: bytes) -> bool:
    """Whether (part of) the next block's header is inside this block, which means that the block lost bytes."""
    name = block[:_NAME_SIZE]
    return block.find(name, 1) >= 0 or any(block.endswith(name[:size]) for size in range(1, _NAME_SIZE))
