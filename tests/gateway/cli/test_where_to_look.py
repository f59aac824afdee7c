"""A gateway whose file says nothing is where everything else looks that is told nothing."""

from inspect import signature

import pytest

from gateway.config.telemetry import Telemetry
from gateway.listeners.outlets.settings import SourceSettings
from gateway.telemetry.client import Machine
from tests.benches.command import here

HERE, PREFIX = "tcp/127.0.0.1:7447", "talc"


def test_a_gateway_is_where_outlets_and_programs_look() -> None:
    assert (Telemetry().listen, SourceSettings().connect) == ((HERE,), (HERE,))
    found = (Telemetry().prefix, SourceSettings().prefix, signature(Machine).parameters["prefix"].default)
    assert found == (PREFIX, PREFIX, PREFIX)


@pytest.mark.parametrize("command", ["watch", "command"])
def test_the_help_says_where_a_command_looks(command: str) -> None:
    told = " ".join(here(command, "--help").out.split())
    assert f"[default: {HERE}]" in told
    assert f"[default: {PREFIX}]" in told
