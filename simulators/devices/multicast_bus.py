"""Emulated CAN nodes on a UDP multicast group (python-can's `udp_multicast`): reachable from other processes."""

import select
import socket
from collections.abc import Sequence
from contextlib import suppress
from threading import Event, Thread, Timer

import can
from can.interfaces.udp_multicast.utils import pack_message

from simulators.devices.slcan_adapter import CanFrame, CanNode
from simulators.devices.spoil import Spoil

_WAIT_S = 0.05


class MulticastBus:
    """Nodes on one group and port, restricted to this computer. A thread runs between start and stop."""

    def __init__(self, nodes: Sequence[CanNode], group: str, port: int) -> None:
        self._nodes, self._group, self._port = tuple(nodes), group, port
        self._bus: can.BusABC | None = None
        self._ended = Event()
        self._thread: Thread | None = None
        self.spoil: Spoil | None = None
        """What happens to datagrams on the wire; the sender is a frame's identifier."""

    def start(self) -> None:
        """Raises OSError or can.CanError when the group cannot be joined."""
        self._bus = can.Bus(interface="udp_multicast", channel=self._group, port=self._port, hop_limit=0)
        self._ended.clear()
        self._thread = Thread(target=self._listen, args=(self._bus,), name=f"multicast {self._port}", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Leave the group; nothing answers any more."""
        if self._thread is not None and self._bus is not None:
            self._ended.set()
            self._thread.join()
            self._bus.shutdown()
            self._thread = self._bus = None

    def send(self, frames: Sequence[CanFrame]) -> None:
        """Frames that nodes send unasked."""
        for identifier, data in frames:
            if self._bus is None:
                return
            number, extended = identifier & 0x1FFFFFFF, bool(identifier >> 31)
            message = can.Message(arbitration_id=number, data=data, is_extended_id=extended)
            if self.spoil is None:
                self._bus.send(message)
                continue
            for delay_s, heard in self.spoil(identifier, pack_message(message)):
                if delay_s > 0:
                    Timer(delay_s, self._send_datagram, [heard]).start()
                else:
                    self._send_datagram(heard)

    def _send_datagram(self, data: bytes) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
            sender.sendto(data, (self._group, self._port))

    def _listen(self, bus: can.BusABC) -> None:
        """Runs in the thread. Packets of other programs that python-can cannot read are skipped."""
        while not self._ended.is_set():
            if not select.select([bus.fileno()], [], [], _WAIT_S)[0]:  # python-can itself would wait by the wall clock
                continue
            with suppress(Exception):  # whatever the unpacking raises
                message = bus.recv(0.0)
                if message is not None:
                    self._on_message(message)

    def _on_message(self, message: can.Message) -> None:
        identifier = message.arbitration_id | message.is_extended_id << 31
        for node in self._nodes:
            self.send(node.on_frame(identifier, bytes(message.data)))
