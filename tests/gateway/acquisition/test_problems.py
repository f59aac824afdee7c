"""What is told of problems that come once, turn into others, or come and go."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.acquisition.problems import Steadiness, Word

WINDOW_S = 60.0


def test_a_problem_is_told_when_it_begins_and_when_it_ends() -> None:
    seen = Steadiness(WINDOW_S)
    assert not seen.well("a", 0.0)
    assert [seen.bad("a", "silent", t) for t in (1.0, 2.0, 3.0)] == [Word.TELL, Word.NOTHING, Word.NOTHING]
    assert seen.bad("a", "noise", 4.0) is Word.TELL  # it turned into another
    assert seen.bad("a", "silent", 5.0) is Word.NOTHING
    assert [seen.well("a", t) for t in (6.0, 7.0)] == [True, False]


def test_subjects_do_not_know_each_other() -> None:
    seen = Steadiness(WINDOW_S)
    assert seen.bad("a", "silent", 0.0) is Word.TELL
    assert seen.bad("b", "silent", 0.0) is Word.TELL
    assert seen.well("a", 1.0)
    assert seen.bad("b", "silent", 2.0) is Word.NOTHING


def test_what_comes_and_goes_is_told_so_and_then_only_when_it_is_steady() -> None:
    seen = Steadiness(WINDOW_S, most=3)
    told = [(t, seen.well("a", float(t)) if t % 2 else seen.bad("a", "silent", float(t))) for t in range(600)]
    said = [(t, word) for t, word in told if word not in (Word.NOTHING, False)]
    assert said == [(0, Word.TELL), (1, True), (2, Word.TELL), (3, True), (4, Word.TELL), (5, True), (6, Word.LAST)]
    assert [t for t in range(600, 800) if seen.well("a", float(t))] == [659]  # well since 599
    assert seen.bad("a", "silent", 900.0) is Word.TELL


def test_what_came_and_went_and_is_bad_for_good_is_no_longer_silent_about_new_kinds() -> None:
    seen = Steadiness(WINDOW_S, most=1)
    for t in (0.0, 2.0):
        seen.bad("a", "silent", t)
        seen.well("a", t + 1.0)
    assert seen.bad("a", "noise", 4.0) is Word.NOTHING
    assert seen.bad("a", "noise", 64.0) is Word.TELL
    assert seen.well("a", 65.0)


@given(st.lists(st.tuples(st.booleans(), st.floats(0.1, 90.0)), max_size=200))
def test_ends_are_told_of_what_was_told_to_begin_and_there_is_a_limit_in_any_window(
    steps: list[tuple[bool, float]],
) -> None:
    seen, now, open_, begun = Steadiness(WINDOW_S, most=3), 0.0, False, list[float]()
    for bad, passed_s in steps:
        now += passed_s
        if bad:
            if seen.bad("a", "silent", now) is not Word.NOTHING:
                assert not open_, "told twice that it begins"
                open_ = True
                begun.append(now)
        elif seen.well("a", now):
            assert open_, "told that it ends, and not that it began"
            open_ = False
    assert all(later - first >= WINDOW_S for first, later in zip(begun, begun[4:], strict=False))


@pytest.mark.parametrize("most", [1, 3])
def test_slow_changes_are_all_told(most: int) -> None:
    seen = Steadiness(WINDOW_S, most=most)
    for t in range(0, 2000, 200):
        assert seen.bad("a", "silent", float(t)) is Word.TELL
        assert seen.well("a", t + 100.0)
