"""The summary of the tests reports how often a device had to be asked again."""

import subprocess
import sys
from pathlib import Path
from typing import Literal

import pytest

from tests.benches.asked_again import MOST_REPEATS, told

ROOT = Path(__file__).parents[1]

TESTS = """
import asyncio
import pytest
from drivers.base import NoAnswer
from tests.benches.asked_again import answered

async def ask(again: bool, late=[1, 2, 3]) -> str:
    if late and late.pop():
        raise NoAnswer("late")
    return "here"

def test_one() -> None:
    assert asyncio.run(answered(ask)) == "here"

def test_other() -> None:
    assert asyncio.run(answered(ask)) == "here"

def test_silent() -> None:
    with pytest.raises(NoAnswer):
        asyncio.run(answered(lambda again: ask(again, [1] * 100)))
"""


BOTH: tuple[Literal["call"], Literal["teardown"]] = ("call", "teardown")


def report(test: str, when: Literal["setup", "call", "teardown"], **properties: object) -> pytest.TestReport:
    return pytest.TestReport(test, ("", 0, ""), {}, "passed", None, when, user_properties=list(properties.items()))


def test_each_test_counts_once_and_without_a_repeat_nothing_is_said() -> None:
    name = "asked again"
    reports = [report(t, when, **{name: n}) for t, n in (("a", 2), ("b", 5)) for when in BOTH]
    assert told([*reports, report("c", "call")]) == "asked again: 7 times in 2 tests, 5 times in b"
    assert told([report("c", "call")]) == ""


@pytest.mark.parametrize("workers", ["0", "1"])
def test_the_summary_says_it_also_of_tests_in_other_processes(workers: str, tmp_path: Path) -> None:
    (tmp_path / "test_late.py").write_text(TESTS)
    run = [sys.executable, "-m", "pytest", "-q", "-p", "tests.benches.asked_again", "-p", "no:cacheprovider"]
    run += ["-n", workers, "-c", str(ROOT / "pyproject.toml"), str(tmp_path / "test_late.py")]
    done = subprocess.run(run, cwd=ROOT, capture_output=True, text=True, timeout=600, check=False)
    assert "3 passed" in done.stdout, done.stdout + done.stderr
    (line,) = (line for line in done.stdout.splitlines() if line.startswith("asked again"))
    assert line.startswith(f"asked again: {3 + MOST_REPEATS} times in 2 tests, {MOST_REPEATS} times in ")
    assert line.endswith("::test_silent")
