"""When a failing device is asked again."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.runtime.breaker import Breaker


def asked_at(breaker: Breaker, until_s: int) -> list[int]:
    """Seconds at which a device that never answers is asked, polled once a second."""
    times = []
    for now in range(until_s):
        if breaker.allows(now):
            times.append(now)
            breaker.failed(now)
    return times


def test_waits_double_up_to_the_longest() -> None:
    assert asked_at(Breaker(1.0, 10.0), 50) == [0, 1, 3, 7, 15, 25, 35, 45]


def test_an_answer_resets_the_wait() -> None:
    breaker = Breaker(1.0, 60.0)
    asked_at(breaker, 20)
    breaker.succeeded()
    assert breaker.allows(0.0)
    assert not breaker.failing
    breaker.failed(100.0)
    assert breaker.retry_at == 101.0


@given(st.integers(1, 5000))
def test_a_long_fault_never_waits_longer_than_the_longest(failures: int) -> None:
    breaker = Breaker(0.1, 60.0)
    for _ in range(failures):
        breaker.failed(0.0)
    assert 0.1 <= breaker.retry_at <= 60.0


def test_overdue_after_another_longest_wait() -> None:
    breaker = Breaker(1.0, 10.0)
    breaker.failed(0.0)
    assert not breaker.overdue(10.9)
    assert breaker.overdue(11.0)


def test_invalid_waits_are_refused() -> None:
    with pytest.raises(ValueError, match="expected 0 < shortest <= longest"):
        Breaker(2.0, 1.0)
