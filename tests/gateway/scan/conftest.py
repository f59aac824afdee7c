"""Free ports for the tests in this folder."""

import socket

import pytest


@pytest.fixture
def free_udp_port() -> int:
    """A port that is not in use at this moment."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        return int(probe.getsockname()[1])
