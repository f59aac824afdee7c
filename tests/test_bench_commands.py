"""Benches that measure for minutes to days, by their own commands and in a small size."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
LIMIT_S = 300.0


def said(*command: str) -> list[str]:
    """Lines that a bench prints."""
    done = subprocess.run(
        [sys.executable, "-m", *command], cwd=ROOT, capture_output=True, text=True, timeout=LIMIT_S, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout.splitlines()


def numbers(line: str) -> list[float]:
    """Of a table's row, without the first cell."""
    return [float(number) for number in re.findall(r"[\d.]+", line.split("|", 2)[-1])]


def test_fuzz() -> None:
    assert said("tests.benches.fuzz", "opcua", "--examples", "1")[-1].split() == [
        "opcua",
        "1",
        "examples",
        "0",
        "wrong",
    ]


def test_history_day_answers_all_that_was_stored() -> None:
    _, *rows = said("tests.benches.history_day", "0.5")
    values = {row.split("|")[1].strip(): numbers(row)[0] for row in rows}
    assert values == {"minutes": 900, "ten minutes": 90, "10 s": 5400, "single readings": 54000}


def test_service_memory() -> None:
    *_, row = said("tests.benches.service_memory", "--days", "0")
    pss, own, most = numbers(row)
    assert 30.0 < own <= most
    assert own < pss < 300.0


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
def test_page_browsers() -> None:
    _, _, row = said("tests.benches.page_browsers", "1", "3")
    assert re.search(r"ms \([1-3] of 3\)", row), row


@pytest.mark.peer
def test_outlets_cost() -> None:
    *programs, stored = said("tests.benches.outlets_cost", "1", "3")
    assert [line.split("  ")[0] for line in programs] == [
        "publish: no message",
        "publish: MQTT and InfluxDB",
        "opcua, without a client",
    ]
    found = re.search(r"'count': (\d+)", stored)
    assert found is not None
    assert int(found[1]) >= 3 * 15, "three keys, each second"
