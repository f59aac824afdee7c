"""A release is one version everywhere, and a tag that says the same."""

import subprocess
from pathlib import Path
from shutil import copy

import pytest

from tests.benches.release import ROOT, faults, stated

NAMES = ("pyproject.toml", "deploy/simulators/pyproject.toml", "CITATION.cff", "CHANGELOG.md")
VERSION = stated(ROOT)["pyproject.toml"]
TAG, OTHER = f"v{VERSION}", "999.0.0"
MESSAGE = f"talc-gateway {VERSION}\n\nSigned-off-by: A Maintainer <maintainer@example.com>"


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """The files of this tree that name the version, with nothing unreleased, in a separate repository."""
    (tmp_path / "deploy/simulators").mkdir(parents=True)
    for name in NAMES:
        copy(ROOT / name, tmp_path / name)
    log = tmp_path / "CHANGELOG.md"
    log.write_text(log.read_text(encoding="utf-8").replace("## [Unreleased]\n", ""), encoding="utf-8")
    git(tmp_path, "init", "--quiet")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "--quiet", "--message", "Release")
    return tmp_path


def git(tree: Path, *arguments: str) -> None:
    who = ("-c", "user.name=A Maintainer", "-c", "user.email=maintainer@example.com")
    subprocess.run(["git", "-C", tree, *who, *arguments], check=True)


def test_this_tree_names_one_version_and_so_does_its_tag() -> None:
    assert faults(ROOT) == []


def test_a_release_as_contributing_describes_it(tree: Path) -> None:
    git(tree, "tag", "--annotate", TAG, "--message", MESSAGE)
    assert faults(tree) == []


@pytest.mark.parametrize("name", NAMES)
def test_another_version_in_one_place_is_found(tree: Path, name: str) -> None:
    text = (tree / name).read_text(encoding="utf-8")
    old = {"CHANGELOG.md": f"## [{VERSION}]", "CITATION.cff": f"version: {VERSION}"}.get(name, f'version = "{VERSION}"')
    assert old in text
    (tree / name).write_text(text.replace(old, old.replace(VERSION, OTHER)), encoding="utf-8")
    assert [fault for fault in faults(tree) if name in fault]


@pytest.mark.parametrize(
    ("tag", "found"),
    [
        ((TAG,), f"tag {TAG}: not annotated (git tag --annotate)"),
        (("--annotate", TAG, "--message", VERSION), f"tag {TAG}: its message has no line Signed-off-by"),
        (("--annotate", f"v{OTHER}", "--message", MESSAGE), f"tag v{OTHER}: pyproject.toml has {VERSION}"),
    ],
)
def test_a_wrong_tag_is_found(tree: Path, tag: tuple[str, ...], found: str) -> None:
    git(tree, "tag", *tag)
    assert faults(tree) == [found]


def test_a_tag_on_what_is_not_released_is_found(tree: Path) -> None:
    log = tree / "CHANGELOG.md"
    log.write_text("## [Unreleased]\n" + log.read_text(encoding="utf-8"), encoding="utf-8")
    git(tree, "tag", "--annotate", TAG, "--message", MESSAGE)
    assert faults(tree) == [f"tag {TAG}: CHANGELOG.md begins with Unreleased"]
