"""The order in which workers get the tests."""

from collections.abc import Mapping

import pytest

from tests.benches.dealing import dealt

LASTS: Mapping[str, float] = {"package": 15.0, "soak": 5.0, "kills": 4.0, "study": 0.2}
QUICK = [f"quick {number}" for number in range(20)]


def file(test: str) -> str:
    return test.split()[0]


def minutes(test: str) -> float | None:
    return LASTS.get(file(test))


def test_the_longest_begin_at_once_each_on_its_own_worker() -> None:
    tests = [*QUICK[:10], "study 1", "study 2", "kills 1", "package 1", "soak 1", *QUICK[10:]]
    order = dealt(tests, file, minutes, 3)
    assert sorted(order) == sorted(tests)
    shares = [order[:8], order[8:16], order[16:]]  # as xdist cuts 25 tests
    assert [[test for test in share if minutes(test) is not None] for share in shares] == [
        ["package 1"], ["soak 1"], ["kills 1", "study 1", "study 2"],
    ]  # fmt: skip
    assert [file(share[0]) for share in shares] == ["package", "soak", "kills"]
    assert [test for test in order if test in QUICK] == QUICK, "those that share something stay side by side"


@pytest.mark.parametrize("workers", [1, 4])
def test_without_slow_tests_the_order_stays(workers: int) -> None:
    assert dealt(QUICK, file, minutes, workers) == QUICK


def test_alone_one_worker_begins_with_the_longest() -> None:
    tests = ["quick 1", "study 1", "package 1"]
    assert dealt(tests, file, minutes, 1) == ["package 1", "study 1", "quick 1"]


def test_where_nearly_all_are_slow_none_is_lost() -> None:
    tests = [*(f"study {number}" for number in range(9)), "soak 1", "quick 1"]
    assert sorted(dealt(tests, file, minutes, 3)) == sorted(tests)
