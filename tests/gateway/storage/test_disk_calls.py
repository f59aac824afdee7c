"""Whatever call of a gateway's life the disk refuses, no step is lost without a report, and it recovers by itself."""

from collections.abc import Iterator

import pytest

from tests.benches.disk_calls import LivesProcess
from tests.benches.disk_faults import FAULTS

pytestmark = pytest.mark.slow
_LIVES = 15


@pytest.fixture(scope="module")
def process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LivesProcess]:
    with LivesProcess(tmp_path_factory.mktemp("disk")) as started:
        yield started


def test_refused_at_any_call_it_goes_where_it_is_declared_and_recovers(process: LivesProcess) -> None:
    whole = process.life()
    assert whole.wrong == []
    assert {"w", "t", "s", "c", "r", "l", "u"} <= set(whole.calls), "the life does all that is refused"
    every = len(whole.calls) / _LIVES
    verdicts = {}
    for number in range(_LIVES):  # another fault at each next one of the calls, spread over the life
        at = 1 + int((number + 0.5) * every)
        verdicts[at] = process.life(number % len(FAULTS), at)
    assert {at: verdict.wrong for at, verdict in verdicts.items() if verdict.wrong} == {}
    assert sum(verdict.refused > 0 for verdict in verdicts.values()) >= _LIVES - 3, "lives differ by a few calls"
    assert any(verdict.unstored for verdict in verdicts.values())


def test_a_single_error_while_a_damaged_file_is_read_loses_no_row(process: LivesProcess) -> None:
    whole = process.life()
    read = whole.calls.rindex("t", 0, whole.calls.index("r"))  # SQLite prepares to read; then the file is set aside
    once = next(number for number, fault in enumerate(FAULTS) if fault.name == "EIO, once")
    verdicts = {at: process.life(once, at) for at in range(read + 1, read + 11)}
    assert {at: verdict.wrong for at, verdict in verdicts.items() if verdict.wrong} == {}
    assert all(verdict.refused == 1 for verdict in verdicts.values())


def test_a_synchronisation_that_hangs_changes_nothing(process: LivesProcess) -> None:
    verdict = process.life(len(FAULTS), 200, 300)
    assert verdict.refused == 1
    assert verdict.wrong == []
    assert verdict.told_lost == verdict.not_started == 0
