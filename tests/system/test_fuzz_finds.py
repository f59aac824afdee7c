"""The fuzz bench finds nothing for a while."""

import logging
from collections.abc import Iterator

import pytest

from tests.benches.fuzz import fuzzed

FIVE_SECONDS = {
    "opcua": 8, "agent": 170, "modbus": 100, "can": 25,
    "wire_log": 9_000, "recordings": 4_000, "toml": 6_000, "dbc": 3_500,
}  # fmt: skip
"""The numbers of examples that a recent computer tries in about five seconds of processor time."""


@pytest.fixture(autouse=True)
def _unlogged() -> Iterator[None]:
    """What is logged about damaged answers may not be text."""
    logging.disable(logging.CRITICAL)
    yield
    logging.disable(logging.NOTSET)


@pytest.mark.slow
@pytest.mark.parametrize(("surface", "examples"), FIVE_SECONDS.items())
def test_nothing_comes_through(surface: str, examples: int) -> None:
    """The same examples on every computer."""
    said: list[str] = []
    assert fuzzed(surface, 0.0, examples, 0, said.append), said
