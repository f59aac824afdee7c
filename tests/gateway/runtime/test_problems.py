"""Reports of problems that occur once, change into others, or are intermittent."""

import logging

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.model.codes import NoticeCode
from gateway.model.notice import Notice
from gateway.model.text import Text, plain
from gateway.runtime.problems import Problems, TurnTime
from tests.benches.manual_clock import ManualClock

WINDOW_S = 60.0
LOG = logging.getLogger("test.problems")


def well(subject: str) -> Text:
    """What is said of a subject that works again."""
    return Text(NoticeCode.ANSWERS_AGAIN, subject=subject)


class Seen:
    """Problems on a clock that the test sets, and what they reported last."""

    def __init__(self, most: int = 3) -> None:
        self.clock, self.notices = ManualClock(), list[Notice]()
        self.problems = Problems(self.clock, 1.0, self.notices.append, LOG, most=most)
        assert self.problems.window_s == WINDOW_S

    def bad(self, subject: str, kind: str, now_s: float) -> Notice | None:
        self.clock.move_to(now_s)
        self.notices.clear()
        self.problems.report(subject, plain(f"{subject}: {kind}"), kind)
        return self.notices[0] if self.notices else None

    def well(self, subject: str, now_s: float) -> Notice | None:
        self.clock.move_to(now_s)
        self.notices.clear()
        self.problems.clear(subject, NoticeCode.ANSWERS_AGAIN, subject=subject)
        return self.notices[0] if self.notices else None


async def test_a_problem_is_reported_when_it_begins_and_when_it_ends() -> None:
    seen = Seen()
    assert seen.well("a", 0.0) is None
    assert [seen.bad("a", "silent", t) for t in (1.0, 2.0, 3.0)] == [Notice("a", plain("a: silent")), None, None]
    assert seen.bad("a", "noise", 4.0) == Notice("a", plain("a: noise"))  # it turned into another
    assert seen.bad("a", "silent", 5.0) is None
    assert [seen.well("a", t) for t in (6.0, 7.0)] == [Notice("a", well("a"), ended=True), None]


async def test_subjects_do_not_know_each_other() -> None:
    seen = Seen()
    assert seen.bad("a", "silent", 0.0)
    assert seen.bad("b", "silent", 0.0)
    assert seen.well("a", 1.0)
    assert seen.bad("b", "silent", 2.0) is None


async def test_what_is_intermittent_is_reported_so_and_then_only_when_it_is_steady() -> None:
    seen = Seen(most=3)
    reported = [(t, seen.well("a", float(t)) if t % 2 else seen.bad("a", "silent", float(t))) for t in range(600)]
    said = [(t, notice.text, notice.ended) for t, notice in reported if notice is not None]
    assert said[:-1] == [(t, well("a") if t % 2 else "a: silent", bool(t % 2)) for t in range(6)]
    assert said[-1] == (6, "a: silent; it is intermittent: reported again when it has been steady for 60 s", False)
    assert [t for t in range(600, 800) if seen.well("a", float(t))] == [659]  # well since 599
    assert seen.bad("a", "silent", 900.0) == Notice("a", plain("a: silent"))


async def test_an_intermittent_problem_that_becomes_permanent_reports_new_kinds_again() -> None:
    seen = Seen(most=1)
    for t in (0.0, 2.0):
        seen.bad("a", "silent", t)
        seen.well("a", t + 1.0)
    assert seen.bad("a", "noise", 4.0) is None
    assert seen.bad("a", "noise", 64.0)
    assert seen.well("a", 65.0)


@given(st.lists(st.tuples(st.booleans(), st.floats(0.1, 90.0)), max_size=200))
def test_ends_are_reported_of_what_was_reported_to_begin_and_there_is_a_limit_in_any_window(
    steps: list[tuple[bool, float]],
) -> None:
    seen, now, open_, begun = Seen(most=3), 0.0, False, list[float]()
    for bad, passed_s in steps:
        now += passed_s
        if bad:
            if seen.bad("a", "silent", now):
                assert not open_, "reported twice that it begins"
                open_ = True
                begun.append(now)
        elif seen.well("a", now):
            assert open_, "reported that it ends, and not that it began"
            open_ = False
    assert all(later - first >= WINDOW_S for first, later in zip(begun, begun[4:], strict=False))


@pytest.mark.parametrize("most", [1, 3])
async def test_slow_changes_are_all_reported(most: int) -> None:
    seen = Seen(most=most)
    for t in range(0, 2000, 200):
        assert seen.bad("a", "silent", float(t))
        assert seen.well("a", t + 100.0)


async def test_a_slow_poller_takes_longer_to_count_as_steady() -> None:
    assert Problems(ManualClock(), 30.0, lambda _: None, LOG).window_s == 300.0


async def test_what_is_reported_is_logged_once_and_a_bug_with_its_traceback(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, logger=LOG.name)
    seen, bug = Seen(), ValueError("no rows")
    for _ in range(3):
        seen.problems.report("a", plain("a: unexpected"), "ValueError", bug=bug)
    seen.problems.report("a", plain("a: silent"), "silent")
    for _ in range(2):
        seen.problems.clear("a", NoticeCode.ANSWERS_AGAIN, subject="a")
    assert [(r.levelname, r.getMessage(), r.exc_info is not None) for r in caplog.records] == [
        ("WARNING", "a: unexpected", True),
        ("WARNING", "a: silent", False),
        ("WARNING", well("a"), False),
    ]


def test_of_reasons_that_are_always_others_ten_are_reported_until_the_problem_has_ended() -> None:
    seen = Seen()
    told = [seen.bad("a", f"line {n} is refused", float(n)) for n in range(100)]
    said = [notice.text for notice in told if notice is not None]
    assert said[:9] == [f"a: line {n} is refused" for n in range(9)]
    assert said[9:] == ["a: line 9 is refused; what else goes wrong is not reported until this has ended"]
    assert seen.well("a", 100.0)
    assert seen.bad("a", "line 100 is refused", 101.0) == Notice("a", plain("a: line 100 is refused"))


def test_a_quiet_one_logs_each_unexpected_exception_once_and_notifies_of_all(caplog: pytest.LogCaptureFixture) -> None:
    notices = list[Notice]()
    problems = Problems(ManualClock(), 1.0, notices.append, LOG, quiet=True)
    bug = ValueError("no rows")
    for subject in ("a", "b", "a"):
        problems.report(subject, plain(f"{subject}: unexpected"), "ValueError", bug=bug)
    problems.report("c", plain("c: silent"), "silent")
    assert notices == [
        Notice("a", plain("a: unexpected")),
        Notice("b", plain("b: unexpected")),
        Notice("c", plain("c: silent")),
    ]
    assert [(r.getMessage(), r.exc_info is not None) for r in caplog.records] == [("a: unexpected", True)]


def test_what_is_given_its_time_at_each_turn_is_steady_by_that_time() -> None:
    time, notices = TurnTime(), list[Notice]()
    problems = Problems(time, 1.0, notices.append, LOG, most=1)
    for now_s in (0.0, 10.0):
        time.now_s = now_s
        problems.report("a", plain("silent"), "silent")
        problems.clear("a", NoticeCode.ANSWERS_AGAIN, subject="a")
    notices.clear()
    for now_s in (10.0 + WINDOW_S - 0.1, 10.0 + WINDOW_S):
        assert notices == []
        time.now_s = now_s
        problems.clear("a", NoticeCode.ANSWERS_AGAIN, subject="a")
    assert notices == [Notice("a", well("a"), ended=True)]
