"""docs/tried.md and README.md name the third-party programs that the tests use, with their versions."""

import re
import subprocess
from pathlib import Path

import pytest

from tests.benches.npm_peer import PEERS as NPM_FOLDERS
from tests.benches.tried import PEERS, ROOT, Tried, between_marks, page, short, write

_MAKE = "run: .venv/bin/python -m tests.benches.tried"

_NOT_OF_DRIVERS = {"axe-core", "uplot"}
"""Checks the operators' page."""


def test_the_page_is_up_to_date() -> None:
    made = (ROOT / "docs" / "tried.md").read_text("utf-8")
    assert made == page(), _MAKE


def test_the_table_in_the_readme_is_up_to_date() -> None:
    _, table, _ = between_marks((ROOT / "README.md").read_text("utf-8"))
    assert table == short(), _MAKE
    for peer in PEERS:
        assert f"{peer.name} {peer.version}" in table


def test_both_are_written(tmp_path: Path) -> None:
    readme = (ROOT / "README.md").read_text("utf-8")
    _, table, _ = between_marks(readme)
    (tmp_path / "README.md").write_text(readme.replace(table, "old\n"), "utf-8")
    (tmp_path / "docs").mkdir()
    write(tmp_path)
    assert (tmp_path / "README.md").read_text("utf-8") == readme
    assert (tmp_path / "docs" / "tried.md").read_text("utf-8") == page()


@pytest.mark.parametrize("peer", PEERS, ids=lambda peer: peer.name)
def test_each_peer_is_used_and_its_version_is_known(peer: Tried) -> None:
    assert list(peer.tests()), "no test uses it"
    assert re.match(r"\d+\.\d+", peer.version)


def test_every_package_of_a_peer_is_on_the_page() -> None:
    packages = set()
    for file in NPM_FOLDERS.glob("*/package.json"):
        packages |= set(re.findall(r'"([\w-]+)": "\d', file.read_text("utf-8")))
    assert packages - _NOT_OF_DRIVERS == {peer.package for peer in PEERS if peer.made_by == "npm"}
    needed = set(
        re.findall(
            r"(?m)^need (libmodbus\S+|linuxcnc-uspace|ser2net|mosquitto|influxdb|victoria-metrics) ",
            (ROOT / ".ci" / "run").read_text("utf-8"),
        )
    )
    assert needed == {peer.package for peer in PEERS if peer.made_by == "Debian"}


@pytest.mark.peer
@pytest.mark.parametrize("peer", [p for p in PEERS if p.made_by == "Debian"], ids=lambda peer: peer.name)
def test_debians_version_is_the_stated_one(peer: Tried) -> None:
    command = ["dpkg-query", "-W", "-f", "${Version}", peer.package]
    installed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert re.match(re.escape(peer.version) + r"\b", installed), installed
