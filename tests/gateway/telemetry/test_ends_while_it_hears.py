"""A program whose main thread ends while a callback of its Zenoh session runs."""

import subprocess
import sys

import pytest

from tests.benches.free_port import free_port
from tests.benches.waits import LIMIT_S
from tests.benches.zenoh_sessions import listening


@pytest.mark.parametrize("how", ["closed", "forgotten"])
def test_it_ends_by_its_own_code(how: str) -> None:
    port = free_port()
    session = listening(port)
    try:
        publisher = session.declare_publisher("talc/mill/event")
        with subprocess.Popen(
            [sys.executable, "-m", "tests.benches.ends_while_it_hears", str(port), how],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        ) as process:
            assert process.stdout is not None
            assert process.stderr is not None
            assert process.stdout.readline() == "hears\n", process.stderr.read()
            publisher.put(b"one")
            assert process.wait(LIMIT_S) == 7, process.stderr.read()
    finally:
        session.close()
