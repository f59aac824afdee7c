"""The charts' script and style are those of uPlot's locked npm package, and nothing else."""

from hashlib import sha512
from pathlib import Path

import pytest

from tests.benches.npm_peer import PEERS, node_with

OURS = Path(__file__).parents[3] / "gateway" / "reporting" / "uplot"
FILES = {"uPlot.iife.min.js": "dist", "uPlot.min.css": "dist", "LICENSE": "."}
"""Name to its folder in the package."""


def test_the_stated_hashes_are_those_of_every_file() -> None:
    lines = (OURS / "SHA512SUMS").read_text(encoding="ascii").splitlines()
    stated = {name: digest for digest, _, name in (line.partition("  ") for line in lines)}
    present = {file.name: sha512(file.read_bytes()).hexdigest() for file in OURS.iterdir() if file.name != "SHA512SUMS"}
    assert stated == present
    assert set(stated) == set(FILES)


@pytest.mark.peer
def test_the_files_are_byte_by_byte_those_of_the_locked_package() -> None:
    node_with("uplot", "uplot")  # npm refuses a package that is not that of package-lock.json
    package = PEERS / "uplot" / "node_modules" / "uplot"
    for name, folder in FILES.items():
        assert (OURS / name).read_bytes() == (package / folder / name).read_bytes(), name
