"""Types of numbers as profiles name them, and numbers as text."""

import struct

import pytest

from drivers.number_types import BYTE_FORMATS, WRITTEN_NUMBER, ByteNumber, check_shift, raw_number


@pytest.mark.parametrize("kind", BYTE_FORMATS)
def test_a_type_has_the_size_and_the_sign_of_its_name(kind: ByteNumber) -> None:
    raw = raw_number(kind, "word")
    assert raw.name == "word"
    assert struct.calcsize(BYTE_FORMATS[kind]) == max(raw.bits // 8, 1)
    assert (raw.signed, raw.real) == (kind.startswith("int"), kind.startswith("float"))
    if kind.startswith(("int", "uint")):
        lowest = struct.pack("<" + BYTE_FORMATS[kind], -1 if raw.signed else 2**raw.bits - 1)
        assert set(lowest) == {0xFF}


@pytest.mark.parametrize(("shift", "kind"), [(0, "float32"), (0, "bit"), (15, "int16"), (63, "uint64")])
def test_a_shift_that_leaves_something_is_allowed(shift: int, kind: ByteNumber) -> None:
    check_shift(shift, kind)


@pytest.mark.parametrize(("shift", "kind"), [(1, "float32"), (1, "bit"), (16, "int16"), (1, "bool")])
def test_a_shift_that_leaves_nothing_or_of_a_real_number_is_refused(shift: int, kind: ByteNumber) -> None:
    with pytest.raises(ValueError, match=f"{shift}: expected fewer than the bits of an integer, type is {kind}"):
        check_shift(shift, kind)


@pytest.mark.parametrize("text", ["1", "-1.5e-3", "+2E5", ".5", "5."])
def test_a_number_as_devices_write_it_is_known(text: str) -> None:
    assert WRITTEN_NUMBER.fullmatch(text)


@pytest.mark.parametrize("text", ["1_000", "١", "nan", "inf", "", ".", "1e", " 1", "0x1"])
def test_what_no_device_writes_is_no_number(text: str) -> None:
    assert not WRITTEN_NUMBER.fullmatch(text)
