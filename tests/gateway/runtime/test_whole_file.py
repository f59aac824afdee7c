"""A file is exchanged as a whole, and stays its owner's."""

import os
from pathlib import Path

import pytest

from gateway.runtime.whole_file import write_whole


def test_owner_mode_and_link_of_the_earlier_file_are_kept(tmp_path: Path) -> None:
    real, link = tmp_path / "real.toml", tmp_path / "gateway.toml"
    real.write_text("old", encoding="utf-8")
    real.chmod(0o640)
    owner = (12345, 23456) if os.geteuid() == 0 else (os.getuid(), os.getgid())
    os.chown(real, *owner)
    os.utime(real, (0.0, 0.0))
    link.symlink_to(real)
    write_whole(link, "new\r\n")
    assert (link.is_symlink(), real.read_bytes()) == (True, b"new\r\n")
    now = real.stat()
    assert (now.st_uid, now.st_gid, now.st_mode & 0o7777) == (*owner, 0o640)
    assert now.st_mtime > 0.0
    assert {p.name for p in tmp_path.iterdir()} == {"real.toml", "gateway.toml"}


def test_a_new_file_is_made_and_the_earlier_one_is_where_it_was_asked_to_be(tmp_path: Path) -> None:
    file, earlier = tmp_path / "a", tmp_path / "b"
    write_whole(file, b"1", before=earlier)
    assert not earlier.exists()
    write_whole(file, b"2", before=earlier)
    assert (file.read_bytes(), earlier.read_bytes()) == (b"2", b"1")


def test_what_cannot_be_written_leaves_the_file_as_it_is(tmp_path: Path) -> None:
    file = tmp_path / "a"
    file.write_text("old", encoding="utf-8")
    (tmp_path / "a.part").mkdir()
    with pytest.raises(OSError, match="directory"):
        write_whole(file, "new")
    assert file.read_text(encoding="utf-8") == "old"
