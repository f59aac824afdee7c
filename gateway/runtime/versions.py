"""Versions of this program and of the packages that results depend on."""

import platform
from contextlib import suppress
from functools import cache
from importlib.metadata import version
from pathlib import Path

_PROGRAM = "talc-gateway"
_NUMERICS = ("numpy", "scipy", "osqp")
_TREE = Path(__file__).parents[2]


@cache
def program_version() -> str:
    """Of this program. In a Git checkout, which is installed once and then changes, with the present commit:
    0.1.0+g1a2b3c4."""
    commit = commit_of(_TREE)
    return f"{version(_PROGRAM)}+g{commit}" if commit else version(_PROGRAM)


def commit_of(tree: Path) -> str:
    """Seven digits of the commit that is checked out in a tree; empty: it is no checkout, or is on no commit yet.

    Read without Git, which a target computer does not have and which takes longer than the rest of a start.
    """
    git = tree / ".git"
    with suppress(OSError):
        if git.is_file():  # of a worktree
            git = tree / git.read_text("utf-8").removeprefix("gitdir:").strip()
        head = (git / "HEAD").read_text("utf-8").strip()
        branch = head.removeprefix("ref: ")
        if branch == head:
            return head[:7]
        with suppress(FileNotFoundError):
            git /= (git / "commondir").read_text("utf-8").strip()
        with suppress(FileNotFoundError):
            return (git / branch).read_text("utf-8")[:7]
        packed = (git / "packed-refs").read_text("utf-8").splitlines()
        return next((line[:7] for line in packed if line.endswith(f" {branch}")), "")
    return ""


def versions(*more: str) -> str:
    """Versions of Python, of this program, of the numerics and of `more` distributions."""
    others = (f"{name} {version(name)}" for name in (*_NUMERICS, *more))
    return ", ".join([f"python {platform.python_version()}", f"{_PROGRAM} {program_version()}", *others])
