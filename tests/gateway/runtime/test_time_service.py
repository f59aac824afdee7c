"""Whether the clock is synchronised where the kernel must not be asked: chrony's answers, and what else may answer."""

import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread

import pytest

from gateway.runtime import time_service
from gateway.runtime.time_service import chrony_synchronised, clock_synchronised

# Answers to `tracking` of chronyd 4.3 (Debian 12): without a server, with one, and with `local stratum 5` alone.
UNSET = bytes.fromhex(
    "06020000002100050000000000000000b711522b00000000000000000000000000000000000000000000000000000000000000000000"
    "0003000000000000000000000000000000000000000000000000000000000000000000000000048000000480000000000000"
)
SET = bytes.fromhex(
    "06020000002100050000000000000000a575bdfb00000000000000007f0000017f00000100000000000000000000000000010000000600"
    "00000000006b0343e92d02d533dd2cd637d114b1b2d4bd40b9f4dce62def704c06faf8867ae0ceba96dcf864e404824403"
)
LOCAL = bytes.fromhex(
    "06020000002100050000000000000000e297864600000000000000007f7f01010000000000000000000000000000000000000000000500"
    "00000000006b0343eb0393fc28000000000000000000000000000000000000000000000000000000000000000000000000"
)
LENGTH = 104


@contextmanager
def chronyd(answer: bytes | None, *, repeats: bool = True) -> Iterator[tuple[str, int]]:
    """Its command port: one answer, with the question's number if it `repeats` that; None: silence."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port:
        port.bind(("127.0.0.1", 0))

        def serve() -> None:
            question, asker = port.recvfrom(1024)
            if len(question) == LENGTH and question[:8] == bytes((6, 1, 0, 0, 0, 33, 0, 0)) and answer is not None:
                port.sendto(answer[:16] + question[8:12] + answer[20:] if repeats else answer, asker)

        serving = Thread(target=serve)
        serving.start()
        yield port.getsockname()
        serving.join()


@pytest.mark.parametrize(("answer", "known"), [(SET, True), (UNSET, False), (LOCAL, False)])
def test_chrony_tells_whether_a_server_has_set_the_clock(answer: bytes, known: bool, patient: None) -> None:
    assert len(answer) == LENGTH
    with chronyd(answer) as place:
        assert chrony_synchronised(place) is known


REFUSED = SET[:8] + bytes((0, 2)) + SET[10:]
"""Status 2, unauthorised."""
LATER = bytes((7,)) + SET[1:]
"""An answer in another version of the protocol."""


@pytest.mark.parametrize("answer", [b"", SET[:20], REFUSED, LATER])
def test_an_invalid_answer_says_nothing(answer: bytes) -> None:
    with chronyd(answer) as place:
        assert chrony_synchronised(place) is None


def test_an_answer_to_another_question_tells_nothing() -> None:
    with chronyd(SET, repeats=False) as place:
        assert chrony_synchronised(place) is None


def test_where_nobody_answers_nothing_is_known() -> None:
    with chronyd(None) as place:
        assert chrony_synchronised(place) is None
    assert chrony_synchronised(place) is None  # nobody has the port any more


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A busy computer does not make an answer late."""
    monkeypatch.setattr(time_service, "CHRONYD_WAIT_S", 60.0)


def test_without_the_kernel_chrony_is_believed_and_else_the_file_of_timesyncd(tmp_path: Path, patient: None) -> None:
    def asked(timesyncd: Path, chronyd: tuple[str, int]) -> bool | None:
        return clock_synchronised(timesyncd, chronyd, kernel=lambda: None)  # as under ProtectClock

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as gone:
        gone.bind(("127.0.0.1", 0))
        nobody = gone.getsockname()
    assert asked(tmp_path / "absent", nobody) is None
    assert asked(tmp_path, nobody) is False
    (tmp_path / "synchronized").touch()
    assert asked(tmp_path, nobody) is True
    with chronyd(UNSET) as place:
        assert asked(tmp_path, place) is False
