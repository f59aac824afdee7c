"""What is said of an error of the operating system: its words once, without numbers, names and addresses."""

import errno
import socket
import ssl
import termios

import can
import pytest

from drivers.base import ConnectError
from drivers.byte_stream import TcpStream
from drivers.error_words import error_number, in_words
from tests.benches.buses import make_bus
from tests.benches.free_port import free_port

LOCKED = "Could not exclusively lock port /dev/ttyUSB0: [Errno 11] Resource temporarily unavailable"
BOTH = (
    "Multiple exceptions: [Errno 111] Connect call failed ('::1', 9, 0, 0), "
    "[Errno 101] Connect call failed ('10.0.0.7', 9)"
)


@pytest.mark.parametrize(
    ("error", "words", "number"),
    [
        (ConnectionRefusedError(111, "Connect call failed ('127.0.0.1', 9)"), "Connection refused", 111),
        (OSError(BOTH), "Connection refused, Network is unreachable", 111),
        (OSError(BOTH.replace("101", "111")), "Connection refused", 111),
        (socket.gaierror(socket.EAI_NONAME, "Name or service not known"), "Name or service not known", None),
        (OSError(LOCKED), "Resource temporarily unavailable", errno.EAGAIN),
        (termios.error(22, "Invalid argument"), "Invalid argument", errno.EINVAL),
        (can.CanOperationError("Error receiving: [Errno 100] Network is down", 100), "Network is down", errno.ENETDOWN),
        (ssl.SSLError(1, "[SSL: WRONG_VERSION_NUMBER]"), "[SSL: WRONG_VERSION_NUMBER]", None),
        (ValueError("Not a valid baudrate: 5"), "Not a valid baudrate: 5", None),
        (TimeoutError(), "TimeoutError", None),
    ],
)
def test_an_error_is_said_in_the_words_of_the_operating_system(
    error: Exception, words: str, number: int | None
) -> None:
    assert (in_words(error), error_number(error)) == (words, number)


@pytest.mark.parametrize(
    ("kind", "options", "said"),
    [
        ("me_rs485", {"port": "nope"}, "cannot open serial port nope: No such file or directory (is the adapter"),
        ("me_rs485", {"port": "/dev/null"}, "cannot open serial port /dev/null: Inappropriate ioctl for device (this"),
        ("canopen", {"interface": "slcan", "channel": "nope"}, "cannot open slcan nope: No such file or directory (is"),
    ],
)
async def test_a_bus_that_cannot_be_opened_says_why_and_what_to_do(
    kind: str, options: dict[str, object], said: str
) -> None:
    with pytest.raises(ConnectError) as refused:
        await make_bus("b", kind, options).connect()
    assert str(refused.value).startswith(f"bus b: {said}")


async def test_a_closed_port_of_a_host_is_reported_as_refused() -> None:
    port = free_port()
    with pytest.raises(ConnectError) as refused:
        await make_bus("b", "modbus_tcp", {"host": "127.0.0.1", "port": port}).connect()
    assert str(refused.value) == f"bus b: cannot connect to 127.0.0.1:{port}: Connection refused (check host and port)"


async def test_a_name_that_no_host_can_have_is_reported_as_that() -> None:
    with pytest.raises(ConnectError, match=r"cannot connect to a\.\.b:502: no host can have this name \("):
        await TcpStream("b", "a..b", 502).open(1.0)
