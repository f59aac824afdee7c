"""Breaks the code behind each promise of docs/safety.md: the test that guards it must fail.

Each mutation runs its one test in a copy of the tree, in a process of its own.
"""

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.benches.safety_page import ROOT, Mutation, mutations

FOLDERS = ("gateway", "drivers", "talc", "simulators", "tests", "docs", "deploy", "examples")
LIMIT_S = 900.0
"""Real time for one test; on an idle computer the slowest takes half a minute. A test that hangs is ended and fails."""
FAILED = 1
"""Exit code of pytest when tests ran and some failed; others mean that nothing was tested."""
# The environment's editable install leads every import to the tree that it was made from, also in child processes.
SITE = """
import sys
sys.meta_path = [finder for finder in sys.meta_path if "editable" not in type(finder).__module__.lower()]
"""
MUTATIONS = mutations()


def copied(to: Path) -> None:
    """The tree with its compiled kernel; byte code is copied too, so that only the broken file is compiled again."""
    for name in FOLDERS:
        shutil.copytree(ROOT / name, to / name, ignore=shutil.ignore_patterns("*.so", "build"))
    shutil.copy2(ROOT / "pyproject.toml", to)
    kernel = importlib.util.find_spec("talc._kernel")
    assert kernel is not None
    assert kernel.origin is not None
    shutil.copy2(kernel.origin, to / "talc")
    (to / "site").mkdir()
    (to / "site" / "sitecustomize.py").write_text(SITE)


def run(tree: Path, test: str) -> subprocess.CompletedProcess[str]:
    """One test, without what pytest keeps between runs."""
    return subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "-p", "no:xdist", test],
        cwd=tree,
        env={
            **{name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")},
            "PYTHONPATH": os.pathsep.join([str(tree / "site"), str(tree)]),
        },
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )


@pytest.mark.slow
@pytest.mark.parametrize("mutation", MUTATIONS, ids=[f"{m.function}-{i}" for i, m in enumerate(MUTATIONS)])
def test_without_the_code_behind_a_promise_its_test_fails(mutation: Mutation, tmp_path: Path) -> None:
    copied(tmp_path)
    (tmp_path / mutation.file).write_text(mutation.applied(), encoding="utf-8")
    done = run(tmp_path, mutation.test)
    assert done.returncode == FAILED, f"{mutation.promise}: broken, and its test does not fail:\n{done.stdout[-3000:]}"


@pytest.mark.slow
def test_the_copy_is_what_runs(tmp_path: Path) -> None:
    """Unbroken a test passes in the copy, and it is the copy's code that it tests."""
    copied(tmp_path)
    test = tmp_path / "tests" / "test_where.py"
    test.write_text(
        "import gateway, drivers, talc._kernel, simulators, tests.benches, pathlib, sys\n"
        "def test_where() -> None:\n"
        "    here = pathlib.Path.cwd()\n"
        "    found = [gateway, drivers, talc._kernel, simulators, tests.benches]\n"
        "    places = [m.__file__ or next(iter(m.__path__)) for m in found]\n"
        "    assert all(pathlib.Path(place).is_relative_to(here) for place in places), places\n"
    )
    done = run(tmp_path, "tests/test_where.py")
    assert done.returncode == 0, done.stdout
