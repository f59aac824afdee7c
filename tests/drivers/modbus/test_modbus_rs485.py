"""RS-485 whose direction the port's driver switches by RTS: what the kernel is asked for, and ports that cannot do
it."""

import array
import fcntl
import struct

import pytest

from drivers.base import ConnectError, SetupError
from simulators.devices.pty_port import PtyPort
from tests.benches.buses import make_bus
from tests.benches.refusals import refusing

pytestmark = pytest.mark.simulated_time

TIOCGRS485, TIOCSRS485 = 0x542E, 0x542F
"""asm-generic/ioctls.h"""
ENABLED, ON_SEND, AFTER_SEND = 1, 2, 4
"""linux/serial.h, struct serial_rs485: flags, delay_rts_before_send and delay_rts_after_send in ms, padding."""


@pytest.mark.parametrize(("rts", "flags"), [("high", ENABLED | ON_SEND), ("low", ENABLED | AFTER_SEND)])
async def test_the_kernel_is_asked_to_switch(rts: str, flags: int, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[bytes] = []
    real = fcntl.ioctl

    def ioctl(descriptor: int, request: int, argument: object = 0, mutate: bool = True) -> object:
        if request == TIOCSRS485:
            assert isinstance(argument, array.array)
            asked.append(argument.tobytes())
        return 0 if request in (TIOCGRS485, TIOCSRS485) else real(descriptor, request, argument, mutate)  # type: ignore[call-overload]

    monkeypatch.setattr(fcntl, "ioctl", ioctl)
    port = PtyPort(lambda _: None)
    options = {"port": await port.start(), "rs485_rts": rts, "rs485_before_s": 0.002, "rs485_after_s": 0.005}
    bus = make_bus("rtu1", "modbus_rtu", options)
    try:
        await bus.connect()
    finally:
        await bus.close()
        await port.stop()
    assert [struct.unpack("=8i", one)[:3] for one in asked] == [(flags, 2, 5)]


@pytest.mark.parametrize("kind", ["modbus_rtu", "me_rs485"])
async def test_a_port_that_cannot_switch_is_refused_by_name(kind: str) -> None:
    port = PtyPort(lambda _: None)
    path = await port.start()
    bus, plain = make_bus("b", kind, {"port": path, "rs485_rts": "high"}), make_bus("b", kind, {"port": path})
    try:
        with refusing(ConnectError, f"port_no_rts port={path} omit_rts") as caught:
            await bus.connect()
        await plain.connect()  # the port was not left open: it is exclusive
        assert caught.value.__traceback__ is not None, "which would keep it open"
    finally:
        await plain.close()
        await bus.close()
        await port.stop()


@pytest.mark.parametrize("delay", ["rs485_before_s", "rs485_after_s"])
def test_a_delay_without_switching_is_refused(delay: str) -> None:
    with pytest.raises(SetupError, match=rf"{delay}: 0\.01: has no effect without rs485_rts"):
        make_bus("b", "modbus_rtu", {"port": "/dev/ttyS0", delay: 0.01})
