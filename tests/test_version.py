"""The version of what is built of a tree: by its tags, and without Git."""

import subprocess
from pathlib import Path
from shutil import copy

import pytest
from packaging.version import Version

from gateway.runtime.versions import commit_of

SCRIPT = Path(__file__).parents[1] / "deploy" / "version.sh"


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    (tmp_path / "deploy" / "simulators").mkdir(parents=True)
    copy(SCRIPT, tmp_path / "deploy")
    for folder in (tmp_path, tmp_path / "deploy" / "simulators"):
        (folder / "pyproject.toml").write_text('[project]\nversion = "1.2.0"\n', encoding="utf-8")
    return tmp_path


def git(tree: Path, *words: str) -> str:
    who = ("-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false", "-c", "tag.gpgsign=false")
    return subprocess.run(["git", *who, *words], cwd=tree, check=True, capture_output=True, text=True).stdout.strip()


def version(tree: Path) -> str:
    return subprocess.run(
        [tree / SCRIPT.relative_to(SCRIPT.parents[1])], check=True, capture_output=True, text=True
    ).stdout.strip()


def test_a_source_archive_has_the_version_of_its_file(tree: Path) -> None:
    assert version(tree) == "1.2.0"


def test_a_tag_is_a_release_and_each_commit_after_it_is_newer(tree: Path) -> None:
    git(tree, "init", "--quiet")
    git(tree, "add", ".")
    git(tree, "commit", "--quiet", "--message", "one")
    git(tree, "tag", "v1.1.0")
    assert version(tree) == f"1.2.0+1.g{git(tree, 'rev-parse', '--short=7', 'HEAD')}", "of another release"
    git(tree, "tag", "--annotate", "v1.2.0", "--message", "1.2.0")
    assert version(tree) == "1.2.0"
    git(tree, "commit", "--quiet", "--allow-empty", "--message", "two")
    later = version(tree)
    assert later == f"1.2.0+1.g{git(tree, 'rev-parse', '--short=7', 'HEAD')}"
    assert Version("1.2.0") < Version(later) < Version("1.2.1")
    (tree / "pyproject.toml").write_text('[project]\nversion = "1.2.0"\n# mine\n', encoding="utf-8")
    assert version(tree) == f"{later}.dirty"


def test_a_checkout_that_runs_says_its_commit(tree: Path) -> None:
    assert commit_of(tree) == ""
    git(tree, "init", "--quiet")
    assert commit_of(tree) == "", "nothing is committed"
    git(tree, "add", ".")
    git(tree, "commit", "--quiet", "--message", "one")
    commit = git(tree, "rev-parse", "--short=7", "HEAD")
    assert commit_of(tree) == commit
    git(tree, "pack-refs", "--all")
    assert commit_of(tree) == commit
    git(tree, "worktree", "add", "--quiet", "beside")
    assert commit_of(tree / "beside") == commit
    git(tree, "checkout", "--quiet", "--detach")
    assert commit_of(tree) == commit


def test_it_is_written_into_what_is_built(tree: Path) -> None:
    git(tree, "init", "--quiet")
    git(tree, "add", ".")
    git(tree, "commit", "--quiet", "--message", "one")
    built = version(tree)
    subprocess.run([tree / "deploy" / "version.sh", "write", tree], check=True)
    for folder in (tree, tree / "deploy" / "simulators"):
        assert f'version = "{built}"' in (folder / "pyproject.toml").read_text(encoding="utf-8")
