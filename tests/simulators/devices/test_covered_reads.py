"""A played RTU line answers a request that was not recorded with the part of a recorded answer that it reads."""

import pytest

from drivers.modbus.frames import find_rtu_answer, rtu_request
from drivers.modbus.numbers import Block
from simulators.devices import Passed, stream_script
from simulators.devices.script import Script
from tests.benches.rtu_talk import frame, registers

WHOLE, BITS = Block(4, 10, 5), Block(2, 100, 12)


def script(*said: tuple[Block, bytes]) -> Script:
    events = []
    for number, (block, answer) in enumerate(said):
        events += [Passed(number, True, rtu_request(1, block)), Passed(number + 0.02, False, answer[:3])]
        events += [Passed(number + 0.03, False, answer[3:])]
    made = stream_script(events)
    made.is_rtu = True
    return made


def answered(played: Script, block: Block, unit: int = 1) -> bytes | None:
    said = played.answer(rtu_request(unit, block))
    return find_rtu_answer(b"".join(data or b"" for _, data in said), unit, block)


def test_a_part_of_the_registers_is_that_of_the_next_answer() -> None:
    played = script((WHOLE, registers(1, 1, 2, 3, 4, 5)), (WHOLE, registers(1, 6, 7, 8, 9, 10)))
    assert answered(played, Block(4, 11, 2)) == bytes.fromhex("04 04 0002 0003")
    assert answered(played, Block(4, 10, 1)) == bytes.fromhex("04 02 0001"), "asking for a part takes no turn"
    assert answered(played, WHOLE) == bytes.fromhex("04 0a 0001 0002 0003 0004 0005")
    assert answered(played, Block(4, 14, 1)) == bytes.fromhex("04 02 000a")
    assert [at for at, _ in played.answer(rtu_request(1, Block(4, 14, 1)))] == [pytest.approx(0.03)]
    assert played.unknown == 0


def test_a_request_for_some_of_the_recorded_bits_is_answered_with_those() -> None:
    played = script((BITS, frame(bytes((1, 2, 2)) + 0b1010_0110_0101.to_bytes(2, "little"))))
    assert answered(played, Block(2, 102, 9)) == bytes((2, 2)) + 0b0_1001_1001.to_bytes(2, "little")
    assert answered(played, Block(2, 111, 1)) == bytes((2, 1, 1))


@pytest.mark.parametrize(
    ("block", "unit"), [(Block(4, 9, 2), 1), (Block(4, 14, 2), 1), (Block(3, 10, 1), 1), (Block(4, 10, 1), 2)]
)
def test_what_was_not_recorded_is_not_made_up(block: Block, unit: int) -> None:
    played = script((WHOLE, registers(1, 1, 2, 3, 4, 5)))
    assert answered(played, block, unit) is None
    assert played.unknown == 1


def test_a_refusal_refuses_a_part_and_a_damaged_or_missing_answer_is_none() -> None:
    assert answered(script((WHOLE, frame(bytes((1, 0x84, 2))))), Block(4, 10, 1)) == bytes((0x84, 2))
    assert answered(script((WHOLE, registers(1, 1, 2, 3, 4, 5)[:-1] + b"\0")), Block(4, 10, 1)) is None
    assert answered(script((WHOLE, b"")), Block(4, 10, 1)) is None


def test_without_rtu_the_request_is_unknown() -> None:
    played = script((WHOLE, registers(1, 1, 2, 3, 4, 5)))
    played.is_rtu = False
    assert answered(played, Block(4, 10, 1)) is None
