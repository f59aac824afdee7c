"""The test server of the library pyads as a TwinCAT PLC; Beckhoff's own client talks to it."""

import itertools
import os
import socket
import struct
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from pyads import constants
from pyads.testserver import AdsTestServer, AdvancedHandler, PLCVariable
from pyads.testserver.handler import AmsPacket, AmsResponseData

PORT, NO_SYMBOL = 48898, 1808
_REPLY = struct.pack("<H", 5)
_READ_STATE = struct.pack("<H", constants.ADSCOMMAND_READSTATE)
_NUMBERS = itertools.count(1)


class EmulatedPlc(AdvancedHandler):  # type: ignore[misc]
    """Variables, and the state of the program."""

    def __init__(self, values: Mapping[str, float | bool]) -> None:
        super().__init__()
        self.running = True
        for name, value in values.items():
            if isinstance(value, bool):
                self.add_variable(PLCVariable(name, int(value), constants.ADST_BIT, "BOOL"))
            else:
                self.add_variable(PLCVariable(name, value, constants.ADST_REAL64, "LREAL"))

    def set(self, name: str, value: float | bool) -> None:
        """Set a value, as the PLC's program would."""
        self.get_variable_by_name(name).value = struct.pack("<?" if isinstance(value, bool) else "<d", value)

    def exchange_places(self, one: str, other: str) -> None:
        """Exchange two variables' places, as loading another program would."""
        first, second = self.get_variable_by_name(one), self.get_variable_by_name(other)
        first.index_offset, second.index_offset = second.index_offset, first.index_offset
        self.add_variable(first)
        self.add_variable(second)

    def handle_request(self, request: AmsPacket) -> AmsResponseData:
        if request.ams_header.command_id == _READ_STATE and not self.running:
            stopped = struct.pack("<IHH", 0, constants.ADSSTATE_STOP, 0)
            return AmsResponseData(_REPLY, request.ams_header.error_code, stopped)
        try:
            return super().handle_request(request)
        except KeyError:  # a PLC answers that there is no such variable
            return AmsResponseData(_REPLY, request.ams_header.error_code, struct.pack("<II", NO_SYMBOL, 0))


class _Server(AdsTestServer):  # type: ignore[misc]
    """Its socket stays open while its thread looks at it."""

    def stop(self) -> None:
        self._run = False
        if self.is_alive():
            self.join()
        super().stop()


def unused_host() -> str:
    """An unused loopback address: ADS has one fixed port, so each server needs its own address."""
    return f"127.{(os.getpid() >> 8) % 254 + 1}.{os.getpid() % 254 + 1}.{next(_NUMBERS)}"


@contextmanager
def ads_server(plc: EmulatedPlc) -> Iterator[str]:
    """Run a server inside; yields its address."""
    host = unused_host()
    server = _Server(handler=plc, ip_address=host, logging=False)
    server.start()
    _until_it_listens(host)  # one that is stopped before that never ends
    try:
        yield host
    finally:
        server.stop()


def _until_it_listens(host: str) -> None:
    latest_s = time.monotonic() + 60.0
    while True:
        try:
            socket.create_connection((host, PORT)).close()
        except ConnectionRefusedError:
            if time.monotonic() > latest_s:
                raise
            time.sleep(0.01)
        else:
            return
