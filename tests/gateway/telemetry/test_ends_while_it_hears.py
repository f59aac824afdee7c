"""A program whose main thread ends while a callback of its Zenoh session runs."""

import subprocess
import sys

import pytest

from tests.benches.free_port import free_port
from tests.benches.waits import LIMIT_S
from tests.benches.zenoh_sessions import listening

PROGRAM = """
import sys, threading, time
from gateway.config.telemetry import Telemetry
from gateway.telemetry.kept import Kept, KeptSession
from gateway.telemetry.session import own_access, reader_config

heard, declared = threading.Event(), threading.Event()
telemetry = Telemetry(listen=(), connect=(f"tcp/127.0.0.1:{sys.argv[1]}",))

def take(_):
    heard.set()
    end_s = time.monotonic() + 0.5
    while time.monotonic() < end_s:  # needs the interpreter, also while that ends
        pass

def opened(session):
    session.declare_subscriber("talc/**", take)
    declared.set()

there = Kept(lambda: reader_config(telemetry.connect, own_access(telemetry)), None, telemetry.connect)
kept = KeptSession(there)
kept.start(opened)
declared.wait(10.0)
print("hears", flush=True)
heard.wait(10.0)
if sys.argv[2] == "closed":
    kept.close()
sys.exit(7)
"""


@pytest.mark.parametrize("how", ["closed", "forgotten"])
def test_it_ends_by_its_own_code(how: str) -> None:
    port = free_port()
    session = listening(port)
    command = [sys.executable, "-c", PROGRAM, str(port), how]
    try:
        publisher = session.declare_publisher("talc/mill/event")
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            assert process.stderr is not None
            assert process.stdout.readline() == "hears\n", process.stderr.read()
            publisher.put(b"one")
            assert process.wait(LIMIT_S) == 7, process.stderr.read()
    finally:
        session.close()
