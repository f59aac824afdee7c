"""Another thread ends the wait on a connection."""

import socket
from concurrent.futures import ThreadPoolExecutor

import pytest

from drivers.hang_up import HangUp


def test_a_wait_of_another_thread_ends() -> None:
    here, there = socket.socketpair()
    hang_up = HangUp()
    with here, there, ThreadPoolExecutor(1) as pool:
        here.settimeout(60.0)
        hang_up.take(here)
        heard = pool.submit(here.recv, 1)
        hang_up.now()
        assert heard.result(60.0) == b""
        assert hang_up.done


def test_a_connection_that_is_no_longer_wanted_is_refused() -> None:
    here, there = socket.socketpair()
    hang_up = HangUp()
    hang_up.now()
    with here, there, pytest.raises(TimeoutError):
        hang_up.take(here)


def test_a_connection_that_has_ended_is_hung_up_without_an_error() -> None:
    here, there = socket.socketpair()
    hang_up = HangUp()
    hang_up.take(here)
    here.close()
    there.close()
    hang_up.now()
    assert hang_up.done
