"""Runs benches that measure for minutes to days by their own commands, in a small size."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
LIMIT_S = 900.0


def said(*command: str) -> list[str]:
    """Lines that a bench prints."""
    done = subprocess.run(
        [sys.executable, "-m", *command], cwd=ROOT, capture_output=True, text=True, timeout=LIMIT_S, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout.splitlines()


def numbers(line: str) -> list[float]:
    """The numbers of a table's row, without the first cell."""
    return [float(number) for number in re.findall(r"[\d.]+", line.split("|", 2)[-1])]


def test_history_day_answers_all_that_was_stored() -> None:
    _, *rows = said("tests.benches.history_day", "0.5")
    values = {row.split("|")[1].strip(): numbers(row)[0] for row in rows}
    assert values == {"minutes": 900, "ten minutes": 90, "10 s": 5400, "single readings": 54000}


def test_years_memory_has_learnt_and_stored() -> None:
    *_, first, last = said("tests.benches.years_memory", "--years", "0.02", "--step-s", "3600")
    assert numbers(last)[2:4] == numbers(first)[2:4], "descriptors and threads"
    assert numbers(last)[4] > numbers(first)[4], "what happens is stored"


@pytest.mark.peer
def test_page_memory() -> None:
    _, _, *rows = said("tests.benches.page_memory", "0.005")
    assert len(rows) == 11
    messages, process, heap, nodes = numbers(rows[-1])
    assert messages > 400 * 29
    assert 20.0 < process < 300.0
    assert 0.5 < heap < 100.0
    assert nodes > 500


@pytest.mark.peer
@pytest.mark.realtime
def test_page_gone_at_once() -> None:
    """A killed gateway's connection ends; a lost network would take Zenoh's lease. Tolerance: that lease, 10 s."""
    *_, row = said("tests.benches.page_gone", "2")
    _, gone, longest, *_ = numbers(row)
    assert 0.0 < gone <= longest < 10_000.0


@pytest.mark.peer
def test_outlets_cost() -> None:
    *programs, stored, changed = said("tests.benches.outlets_cost", "1", "3")
    assert [line.split("  ")[0] for line in programs] == [
        "publish: no message",
        "publish: MQTT and InfluxDB",
        "opcua, without a client",
        "opcua, with a client",
    ]
    values, changes = numbers(changed)
    assert changes >= values > 20, "each value comes once at least"
    found = re.search(r"'count': (\d+)", stored)
    assert found is not None
    assert int(found[1]) >= 3, "of three keys"
