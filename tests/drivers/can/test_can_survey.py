"""Whatever frames are on a bus, the survey records what they mean in CiA 301 and nothing else."""

from collections import Counter
from collections.abc import Sequence

import can
from hypothesis import example, given
from hypothesis import strategies as st

from drivers.can.survey import Heard

UPLOAD = bytes.fromhex("40 00 10 00 00 00 00 00")
SERVICES = (0x000, 0x080, 0x180, 0x580, 0x600, 0x700)

nodes = st.integers(0, 0x7F)
identifiers = st.one_of(st.builds(int.__or__, st.sampled_from(SERVICES), nodes), st.integers(0, 0x7FF))
payloads = st.one_of(
    st.binary(max_size=8),
    st.sampled_from([b"\x43", b"\x4b", b"\x80", b"\x42"]).flatmap(
        lambda command: st.binary(max_size=4).map(lambda rest: command + UPLOAD[1:4] + rest)
    ),
)
data_frames = st.one_of(
    st.builds(lambda i, d: can.Message(arbitration_id=i, data=d, is_extended_id=False), identifiers, payloads),
    st.builds(
        lambda i, d: can.Message(arbitration_id=i, data=d, is_extended_id=True), st.integers(0, 2**29 - 1), payloads
    ),
    st.builds(
        lambda i, d: can.Message(arbitration_id=i, data=d, is_extended_id=False, is_fd=True),
        identifiers,
        st.sampled_from([12, 16, 64]).flatmap(lambda size: st.binary(min_size=size, max_size=size)),
    ),
)
other_frames = st.builds(
    lambda i, **kind: can.Message(arbitration_id=i, is_extended_id=False, **kind),
    identifiers,
    is_remote_frame=st.booleans(),
    is_error_frame=st.booleans(),
)
frames = st.lists(st.one_of(data_frames, other_frames), max_size=40)


def plain(heard: Sequence[can.Message], service: int) -> list[tuple[int, bytes]]:
    """Node and data of the data frames of one service, identifiers of 11 bits, in order."""
    return [
        (m.arbitration_id & 0x7F, bytes(m.data))
        for m in heard
        if not (m.is_error_frame or m.is_remote_frame or m.is_extended_id)
        and m.arbitration_id & 0x780 == service
        and m.arbitration_id & 0x7F
    ]


@given(frames, st.sets(st.integers(1, 127)))
@example([can.Message(arbitration_id=0x585, data=b"\x43\x00\x10\x00\x94\x01\x02\x00", is_extended_id=False)] * 2, {5})
def test_any_frames_are_recorded_as_they_are(messages: Sequence[can.Message], asked: set[int]) -> None:
    heard = Heard(answers=dict.fromkeys(asked, 0))
    for message in messages:
        heard.take(message)
    whole = [m for m in messages if not m.is_error_frame]
    assert heard.error_frames == len(messages) - len(whole)
    assert heard.frames == Counter((m.arbitration_id, m.is_extended_id) for m in whole)
    beats = {node: data[0] & 0x7F for node, data in plain(messages, 0x700) if data}
    assert set(heard.states) == set(beats)
    assert {n for n, state in heard.states.items() if state == "operational"} == {n for n in beats if beats[n] == 5}
    assert heard.emergencies == {
        node: data[0] + 256 * data[1] for node, data in plain(messages, 0x080) if len(data) == 8
    }
    answers = [(n, data) for n, data in plain(messages, 0x580) if len(data) == 8 and data[1:4] == UPLOAD[1:4]]
    assert heard.device_types == {
        node: sum(byte << 8 * i for i, byte in enumerate(data[4:])) if data[0] == 0x43 else None
        for node, data in answers
    }
    assert heard.doubled == {node for node in asked if [n for n, _ in answers].count(node) > 1}
    assert heard.nodes == tuple(sorted({*beats, *heard.emergencies, *heard.device_types}))
    assert heard.silent == (not messages)
    assert set(heard.unexplained().items()) <= set(heard.frames.items())


def test_answers_to_another_client_make_no_second_node() -> None:
    heard = Heard()
    answer = can.Message(arbitration_id=0x585, data=bytes.fromhex("4300100094010200"), is_extended_id=False)
    heard.take(answer)
    heard.take(answer)
    heard.answers[5] = 0  # asked now
    heard.take(answer)
    assert heard.doubled == set()
    assert heard.device_types == {5: 0x0002_0194}
    heard.take(answer)
    assert heard.doubled == {5}
