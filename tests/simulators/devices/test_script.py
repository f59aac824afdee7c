"""A recorded Modbus TCP device's answers: their numbers are correct however the bytes were split."""

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from simulators.devices import Passed, stream_script, unnumbered
from simulators.devices.script import numbered

MESSAGE = st.tuples(st.integers(0, 0xFFFF), st.binary(min_size=2, max_size=254))
"""Number, and what follows the length."""


def frame(number: int, body: bytes) -> bytes:
    """A Modbus TCP message."""
    return (number & 0xFFFF).to_bytes(2, "big") + bytes(2) + len(body).to_bytes(2, "big") + body


@st.composite
def conversations(draw: st.DrawFn) -> list[tuple[tuple[int, bytes], list[tuple[int, bytes]], list[bytes]]]:
    """Requests, the messages that followed each, and these messages' bytes in pieces."""
    said = []
    for _ in range(draw(st.integers(1, 3))):
        request, messages = draw(MESSAGE), draw(st.lists(MESSAGE, max_size=4))
        whole = b"".join(frame(*message) for message in messages)
        cuts = draw(st.lists(st.integers(0, len(whole)), max_size=5))
        pieces = [whole[a:b] for a, b in pairwise([0, *sorted(cuts), len(whole)]) if a < b]
        said.append((request, messages, pieces))
    return said


Conversation = list[tuple[tuple[int, bytes], list[tuple[int, bytes]], list[bytes]]]


def passed(said: Conversation) -> list[Passed]:
    events = []
    for request, _, pieces in said:
        events += [Passed(0.0, True, frame(*request)), *(Passed(0.0, False, piece) for piece in pieces)]
    return events


@given(conversations())
def test_answers_are_numbered_from_their_request(said: Conversation) -> None:
    events = unnumbered(passed(said))
    received: list[bytes] = []
    for event in events:
        if event.sent:
            received.append(b"")
        else:
            received[-1] += event.data or b""
    assert [event.data for event in events if event.sent] == [frame(0, body) for (_, body), _, _ in said]
    assert received == [
        b"".join(frame(number - request, body) for number, body in messages) for (request, _), messages, _ in said
    ]


@given(conversations(), st.integers(0, 0xFFFF))
def test_played_they_have_the_number_of_the_request_now(said: Conversation, now: int) -> None:
    script = stream_script(unnumbered(passed(said)))
    turns: dict[bytes, int] = {}
    for (request, body), messages, _ in said:
        turns[body] = turns.get(body, 0) + 1
        rest, out = 0, b""
        for _, data in script.answer(frame(0, body)):
            assert data is not None
            piece, rest = numbered(data, now, rest)
            out += piece
        assert out == b"".join(frame(number - request + now, answer) for number, answer in messages)
    assert script.unknown == 0


@given(st.lists(st.tuples(st.booleans(), st.one_of(st.none(), st.binary(max_size=40))), max_size=10))
def test_any_bytes_keep_their_length_but_for_a_header_that_was_cut(pieces: list[tuple[bool, bytes | None]]) -> None:
    events = [Passed(0.0, sent and data is not None, data) for sent, data in pieces]
    out = unnumbered(events)
    before, after = (sum(len(e.data or b"") for e in some if not e.sent) for some in (events, out))
    heads = 1 + sum(event.data is None for event in events)
    assert before - 6 * heads <= after <= before
    assert [e.data is None for e in out if e.data is None] == [e.data is None for e in events if e.data is None]


def test_a_silence_comes_once_and_one_that_never_answered_stays_silent() -> None:
    asked = [Passed(float(i), True, b"ask") for i in range(4)]
    said = [Passed(0.5, False, b"one"), Passed(2.5, False, b"two")]
    script = stream_script(sorted([*asked, *said, Passed(4.0, True, b"mute")], key=lambda event: event.at_s))
    answers = [[data for _, data in script.answer(b"ask")] for _ in range(7)]
    assert answers == [[b"one"], [], [b"two"], [], [b"one"], [b"two"], [b"one"]]
    assert [list(script.answer(b"mute")) for _ in range(3)] == [[], [], []]
