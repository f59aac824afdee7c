"""A release is one version everywhere, and a tag that says the same.

A commit without a tag may have changes that are not released yet.
"""

import re
import subprocess
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]


def text(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def git(*arguments: str) -> str:
    """The output of git; empty in a folder without a repository, such as a source archive."""
    if not (ROOT / ".git").exists():
        return ""
    return subprocess.run(["git", "-C", ROOT, *arguments], capture_output=True, text=True, check=True).stdout


SERVICE = tomllib.loads(text("pyproject.toml"))["project"]
SIMULATORS = tomllib.loads(text("deploy/simulators/pyproject.toml"))["project"]
VERSION = SERVICE["version"]
HEADINGS = re.findall(r"^## \[(Unreleased(?=\]$)|[^\]]+(?=\] - \d{4}-\d\d-\d\d$))", text("CHANGELOG.md"), re.MULTILINE)
"""Newest first: Unreleased, or a version with its date."""


def test_everything_names_one_version() -> None:
    assert SIMULATORS["version"] == VERSION
    assert f"talc-gateway-simulators=={VERSION}" in SERVICE["optional-dependencies"]["demo"]
    assert f"talc-gateway=={VERSION}" in SIMULATORS["dependencies"]
    assert re.findall(r"^version: (\S+)$", text("CITATION.cff"), re.MULTILINE) == [VERSION]
    assert next(heading for heading in HEADINGS if heading != "Unreleased") == VERSION


def test_a_tag_of_this_commit_says_the_same_and_is_signed_off() -> None:
    for tag in git("tag", "--points-at", "HEAD", "v*").split():
        assert tag == f"v{VERSION}"
        assert git("cat-file", "-t", tag).strip() == "tag", "annotated: git tag --annotate"
        assert re.search(r"^Signed-off-by: .+ <.+>$", git("cat-file", "tag", tag), re.MULTILINE)
        assert HEADINGS[0] == VERSION, "CHANGELOG.md begins with Unreleased"
