"""docs/tried.md names the programs of others that the tests use, with the versions that they are used in."""

import re
import subprocess

import pytest

from tests.benches.npm_peer import PEERS as NPM_FOLDERS
from tests.benches.tried import PEERS, ROOT, Tried, page

_NOT_OF_DRIVERS = {"axe-core"}
"""Checks the operators' page."""


def test_the_page_is_up_to_date() -> None:
    made = (ROOT / "docs" / "tried.md").read_text("utf-8")
    assert made == page(), "run: .venv/bin/python -m tests.benches.tried > docs/tried.md"


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
