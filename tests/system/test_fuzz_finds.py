"""The fuzz bench finds nothing for a while."""

import logging
from collections.abc import Iterator

import pytest

from tests.benches.fuzz import fuzzed

EXAMPLES = {
    "opcua": 2, "agent": 40, "modbus": 25, "can": 6, "wire_log": 2_000, "recordings": 1_000, "toml": 1_500, "dbc": 900,
}  # fmt: skip
"""The numbers of examples that a recent computer tries in about a second."""


@pytest.fixture(autouse=True)
def _unlogged() -> Iterator[None]:
    """What is logged about damaged answers may not be text."""
    logging.disable(logging.CRITICAL)
    yield
    logging.disable(logging.NOTSET)


@pytest.mark.slow
@pytest.mark.parametrize(("surface", "examples"), EXAMPLES.items())
def test_nothing_comes_through(surface: str, examples: int) -> None:
    """The same examples on every computer."""
    said: list[str] = []
    assert fuzzed(surface, 0.0, examples, 0, said.append), said
