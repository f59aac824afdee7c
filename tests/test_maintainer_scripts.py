"""What the Debian package's scripts do, run by dpkg itself, at upgrades that fail, at removal and at a purge.

tests/system/test_debian_package.py tries the whole package under a real systemd, with fewer of the cases.
"""

import os
from pathlib import Path

import pytest

from tests.benches.small_debian import CONFIG, DATABASE, OWN, UNIT, SmallDebian

pytestmark = pytest.mark.peer


@pytest.fixture
def debian(tmp_path: Path) -> SmallDebian:
    """Version 1 is installed, and its service runs."""
    debian = SmallDebian(tmp_path)
    debian.installed(debian.package("1"))
    debian.write(CONFIG, "mine")
    debian.write(DATABASE, "what was learnt")
    debian.start()
    assert debian.calls() == [], "an installation starts nothing"
    return debian


def is_the_earlier(debian: SmallDebian, said: str, why: str) -> None:
    """Program, unit and database are those of version 1, which runs; dpkg says why, and nothing is left over."""
    assert f"talc-gateway: 2 was not taken into use: {why}" in said
    assert debian.text(f"{OWN}/version") == "1"
    assert debian.text(UNIT) == "unit of 1"
    assert (debian.text(CONFIG), debian.text(DATABASE)) == ("mine", "what was learnt")
    assert debian.runs
    assert debian.left() == ["etc/talc-gateway", OWN, "units/talc-gateway.service", "var/lib/talc-gateway"]
    assert {path.name for path in (debian.root / OWN).iterdir()} == {"bin", "share", "version"}


def test_a_program_that_works_is_taken_into_use_and_the_earlier_one_goes(debian: SmallDebian) -> None:
    debian.installed(debian.package("2"))
    assert debian.calls() == ["restart 2"], "the service ran on until then"
    assert (debian.text(f"{OWN}/version"), debian.text(UNIT)) == ("2", "unit of 2")
    assert (debian.text(CONFIG), debian.text(DATABASE)) == ("mine", "what was learnt")
    assert not (debian.root / "opt/talc-gateway.earlier").exists()


def test_a_program_that_refuses_the_configuration_never_interrupts_the_earlier_one(debian: SmallDebian) -> None:
    code, said = debian.dpkg("--install", debian.package("2", "refuses"))
    assert code != 0
    is_the_earlier(debian, said, "it does not accept the configuration")
    assert debian.calls() == []


@pytest.mark.parametrize(
    ("mark", "why"),
    [
        ("does-not-start", "it does not start"),
        ("ends", "it ended by itself within 5 s"),
        ("unwell", "'talc-gateway status' was good before the upgrade and is not any more: channels: 0 of 3 good"),
    ],
)
def test_a_program_that_does_not_work_gives_way_to_the_earlier_one(debian: SmallDebian, mark: str, why: str) -> None:
    code, said = debian.dpkg("--install", debian.package("2", mark))
    assert code != 0
    is_the_earlier(debian, said, why)
    assert debian.calls() == ["restart 2", "stop 2", "reset-failed 1", "start 1"]
    code, said = debian.dpkg("--configure", "talc-gateway")
    assert code != 0
    assert "as 2 did not work; install another package" in said
    debian.installed(debian.package("3"))
    assert debian.text(f"{OWN}/version") == "3"


def test_a_database_that_was_migrated_comes_back_too(debian: SmallDebian) -> None:
    debian.write(f"{DATABASE}.version3", "of an upgrade long ago")
    debian.write(f"{DATABASE}-wal", "of the new program")
    package = debian.package("2", "migrates", "ends")
    (debian.root / f"{DATABASE}.version3").touch()
    _older(debian.root / f"{DATABASE}.version3")
    code, said = debian.dpkg("--install", package)
    assert code != 0
    assert "the database is the one from before the migration" in said
    assert debian.text(DATABASE) == "what was learnt"
    assert debian.text(f"{DATABASE}.failed-upgrade") == "migrated"
    assert debian.text(f"{DATABASE}.version3") == "of an upgrade long ago"
    assert not (debian.root / f"{DATABASE}-wal").exists()


def test_a_gateway_that_was_not_well_before_need_not_be_well_after(debian: SmallDebian) -> None:
    debian.write(f"{OWN}/unwell", "")
    debian.installed(debian.package("2", "unwell"))
    assert debian.text(f"{OWN}/version") == "2"


def test_a_service_that_does_not_run_is_not_started_by_an_upgrade(debian: SmallDebian) -> None:
    (debian.root / "state/active").unlink()
    debian.installed(debian.package("2"))
    assert debian.calls() == []
    assert debian.text(f"{OWN}/version") == "2"


def test_an_upgrade_that_dpkg_breaks_off_leaves_the_service_and_no_second_copy(debian: SmallDebian) -> None:
    debian.installed(debian.other_package("opt/taken"))
    code, said = debian.dpkg("--install", debian.package("2", files=("opt/taken",)))
    assert code != 0
    assert "trying to overwrite '/opt/taken'" in said
    assert debian.calls() == []
    assert debian.runs
    assert debian.text(f"{OWN}/version") == "1"
    assert not (debian.root / "opt/talc-gateway.earlier").exists()


def test_a_running_service_ends_before_it_is_removed_and_a_purge_leaves_nothing(debian: SmallDebian) -> None:
    assert debian.dpkg("--remove", "talc-gateway")[0] == 0
    assert debian.calls() == ["disable 1"], "while its program was there, to take the offsets back"
    assert not debian.runs
    assert (debian.text(CONFIG), debian.text(DATABASE)) == ("mine", "what was learnt")
    assert debian.left() == ["etc/talc-gateway", "var/lib/talc-gateway"]
    debian.write("var/lib/talc-gateway/reports/.day", "hidden")
    assert debian.dpkg("--purge", "talc-gateway")[0] == 0
    assert debian.calls() == ["userdel talc-gateway", "groupdel talc-gateway"]
    assert debian.left() == []


def _older(file: Path) -> None:
    """Make a file older by a day."""
    os.utime(file, (file.stat().st_mtime - 86400.0,) * 2)
