"""A file from outside takes neither all memory nor for ever, whatever is in it."""

import os
import resource
from pathlib import Path

import pytest

from drivers.base import SetupError
from drivers.bounded_file import MOST_BYTES, bytes_of
from drivers.profiles import load_profile
from drivers.toml_text import TomlError, toml_data

SIGNAL = ' SG_ T : 0|8@1- (1,0) [0|0] "" X\n'
PAGED = ' SG_ S M : 8|8@1- (1,0) [0|0] "" X\n SG_ T m1 : 0|8@1- (1,0) [0|0] "" X\n'
LARGEST_MB = 300
LONGEST_S = 10.0


def test_a_pipe_and_a_file_without_end_are_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    large = tmp_path / "large"
    large.write_bytes(bytes(MOST_BYTES + 1))
    for path, why in ((tmp_path / "pipe", "a pipe"), (large, "larger than 256 KiB"), (Path("/dev/zero"), "a device")):
        with pytest.raises(OSError, match=why):
            bytes_of(path)
    large.write_bytes(bytes(MOST_BYTES))
    assert bytes_of(large) == bytes(MOST_BYTES)


@pytest.mark.parametrize(
    ("dbc", "refused"),
    [
        ('BO_ 1 M: 8 X\n SG_ T : 0|4294967296@1- (1,0) [0|0] "" X\n', "does not fit into message M of 8 bytes"),
        (f"BO_ 1 M: 4294967296 X\n{SIGNAL}", "does not fit into message M of 4294967296 bytes"),
        (f"BO_ 1 M: 40000000 X\n{SIGNAL}", "does not fit into message M of 40000000 bytes"),
        (f"BO_ 1 M: 8 X\n{PAGED}\nSG_MUL_VAL_ 1 T S 0-4294967295;\n", "4294967295 selectors"),
        ("BO_ 1 M: 8 X\n" + SIGNAL * 2 + '"\\' * 2**20, "has 2 signals T"),
    ],
)
def test_a_wrong_number_of_a_dbc_is_refused_in_bounded_memory_and_time(tmp_path: Path, dbc: str, refused: str) -> None:
    head = 'protocol = "can_dbc"\ntitle = "x"\nunit = "degC"\ndbc = "x.dbc"\n'
    profile = tmp_path / "x.toml"
    profile.write_text(f'{head}[[signal]]\nmessage = "M"\nname = "T"\n', encoding="utf-8")
    (tmp_path / "x.dbc").write_text(dbc, encoding="ascii")
    before = resource.getrusage(resource.RUSAGE_SELF)
    with pytest.raises(SetupError, match=refused):
        load_profile(str(profile))
    after = resource.getrusage(resource.RUSAGE_SELF)
    assert after.ru_maxrss - before.ru_maxrss < LARGEST_MB * 1024
    assert after.ru_utime - before.ru_utime < LONGEST_S


@pytest.mark.parametrize(
    "text",
    [
        ".".join(["a"] * (MOST_BYTES // 2)) + " = 1",
        'x = "' + '""\\"' * (MOST_BYTES // 4),
        "x = " + '"\\' * (MOST_BYTES // 2),
        "x : " + '"a"' * (MOST_BYTES // 3) + '"',
        "x = " + "{a=" * (MOST_BYTES // 3),
    ],
    ids=["names", "long texts", "texts", "quotes", "brackets"],
)
def test_a_toml_text_that_is_none_is_refused_in_bounded_memory_and_time(text: str) -> None:
    before = resource.getrusage(resource.RUSAGE_SELF)
    with pytest.raises(TomlError):
        toml_data(text)
    after = resource.getrusage(resource.RUSAGE_SELF)
    assert after.ru_maxrss - before.ru_maxrss < LARGEST_MB * 1024
    assert after.ru_utime - before.ru_utime < LONGEST_S
