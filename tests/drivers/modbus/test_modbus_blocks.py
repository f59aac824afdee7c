"""Block reads: few requests, within the device's limit, and never short of a register."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.base import NoAnswer, Refused
from drivers.modbus.answers import BlockAnswers
from drivers.modbus.numbers import Block, as_in_manuals
from drivers.modbus.plan import ReadPlan, plan_blocks


def test_neighbours_are_read_at_once() -> None:
    assert plan_blocks([(4, i, 1) for i in range(6)], 125, 8) == (Block(4, 0, 6),)


def test_far_registers_and_other_functions_are_asked_for_apart() -> None:
    places = [(4, 0, 2), (4, 200, 1), (3, 1, 1), (2, 128, 1)]
    assert plan_blocks(places, 125, 8) == (Block(2, 128, 1), Block(3, 1, 1), Block(4, 0, 2), Block(4, 200, 1))


def test_limit_of_the_device_is_kept() -> None:
    assert plan_blocks([(3, i, 2) for i in range(0, 20, 2)], 8, 0) == (Block(3, 0, 8), Block(3, 8, 8), Block(3, 16, 4))


def test_small_gap_costs_less_than_a_request() -> None:
    assert plan_blocks([(3, 0, 1), (3, 9, 1)], 125, 8) == (Block(3, 0, 10),)
    assert plan_blocks([(3, 0, 1), (3, 10, 1)], 125, 8) == (Block(3, 0, 1), Block(3, 10, 1))
    assert plan_blocks([(3, 0, 1), (3, 2, 1)], 125, 0) == (Block(3, 0, 1), Block(3, 2, 1))


def test_no_request_reads_more_bits_than_modbus_allows() -> None:
    assert plan_blocks([(1, i, 1) for i in range(2001)], 125, 8) == (Block(1, 0, 2000), Block(1, 2000, 1))


def silence(request: Block) -> NoAnswer:
    return NoAnswer(f"{request}")


def test_one_late_refusal_is_not_believed_and_of_a_request_that_was_answered_not_even_three() -> None:
    plan = ReadPlan([(3, 0, 1)], 125, 8, silence)
    (request,) = plan.requests
    absent, fails = Refused("illegal data address", absent=True), Refused("device failure")
    assert [plan.is_certain(request, absent) for _ in range(2)] == [False, True]
    for _ in range(2):
        plan.answered(request)  # the refusals before it do not count
        assert [plan.is_certain(request, absent) for _ in range(4)] == [False, False, False, True]
    plan.answered(request)
    assert [plan.is_certain(request, fails) for _ in range(16)] == [False] * 15 + [True], "it may be better soon"


@given(
    st.lists(st.tuples(st.sampled_from([1, 2, 3, 4]), st.integers(0, 400), st.integers(1, 2))),
    st.integers(2, 125),
    st.integers(0, 20),
)
def test_every_place_lies_whole_in_one_block(places: list[tuple[int, int, int]], limit: int, gap: int) -> None:
    blocks = plan_blocks(places, limit, gap)
    for function, address, width in places:
        assert any(
            b.function == function and b.address <= address and address + width <= b.address + b.count for b in blocks
        )
    assert all(block.count <= (2000 if block.function <= 2 else limit) for block in blocks)


@given(
    st.lists(st.tuples(st.sampled_from([3, 4]), st.integers(0, 40), st.just(1)), min_size=2),
    st.lists(st.tuples(st.booleans(), st.integers(0, 5)), max_size=60),
    st.integers(0, 8),
)
def test_every_place_is_asked_for_or_left_out_and_never_both(
    places: list[tuple[int, int, int]], course: list[tuple[bool, int]], gap: int
) -> None:
    plan = ReadPlan(places, 8, gap, silence)
    now_s = 0.0
    for step, (flag, number) in enumerate(course):
        now_s += 1.0
        due = plan.silent_due(now_s)
        if flag and due is not None:
            plan.asked_silent(due, now_s, answered=number == 0)
        elif number == 5 and flag:
            plan.reset(silent=bool(step % 2))
        else:
            request = plan.requests[number % len(plan.requests)]
            while len(plan.requests) > 1 and not plan.fell_silent(request, now_s, hurried=bool(number % 2)):
                pass
        for function, address, width in places:
            asked = any(
                b.function == function and b.address <= address and address + width <= b.address + b.count
                for b in plan.requests
            )
            assert asked != ((function, address, width) in plan.lost)
        assert plan.requests, "one request is always left"


def test_a_miss_with_the_full_time_counts_twice_and_an_answer_ends_the_count() -> None:
    plan = ReadPlan([(3, 0, 1), (4, 0, 1)], 125, 8, silence)
    request = plan.requests[0]
    assert [plan.fell_silent(request, 0.0, hurried=True) for _ in range(6)] == [False] * 6
    plan.answered(request)
    assert [plan.fell_silent(request, 0.0, hurried=False) for _ in range(4)] == [False] * 3 + [True]


def test_the_only_request_is_never_left_out() -> None:
    plan = ReadPlan([(3, 0, 1)], 125, 8, silence)
    assert not any(plan.fell_silent(plan.requests[0], 0.0, hurried=False) for _ in range(9))


def test_what_was_answered_too_early_is_asked_for_again() -> None:
    """A status that comes after its value cannot say that the value was valid."""
    status, value = Block(3, 0, 1), Block(4, 0, 1)
    answers = BlockAnswers()
    for _ in range(3):
        assert answers.next_of([status, value], in_order=True) == status
        answers.missed(status)
    assert answers.next_of([status, value], in_order=True) == value, "does the unit answer at all?"
    answers.add(value, (5,))
    assert answers.next_of([status, value], in_order=True) == status
    answers.add(status, (0,), later=[value])
    assert answers.next_of([status, value], in_order=True) == value


@pytest.mark.parametrize(
    ("number", "function", "address"),
    [(30101, 4, 100), (300101, 4, 100), (365536, 4, 65535), (40001, 3, 0), (400001, 3, 0), (465536, 3, 65535)],
)
def test_an_address_as_in_a_manual_is_explained(number: int, function: int, address: int) -> None:
    told = [int(word) for word in re.findall(r"\d+", as_in_manuals(number))]
    assert told[-3:] == [number, function, address]


@pytest.mark.parametrize("number", [0, 100, 30000, 40000, 50000, 65535, 300000, 365537, 465537])
def test_another_address_is_not(number: int) -> None:
    assert as_in_manuals(number) == ""
