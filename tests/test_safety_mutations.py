"""Breaks the code behind each promise of docs/safety.md: the test that guards it must fail.

Each mutation runs its one test in a copy of the tree, in a separate process.
"""

import importlib.util
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.benches.forked_tests import ForkedTests
from tests.benches.safety_page import ROOT, Mutation, mutations

FOLDERS = ("gateway", "drivers", "talc", "simulators", "tests", "docs", "deploy", "examples")
LIMIT_S = 900.0
"""Real time for one test; on an idle computer the slowest takes half a minute. A test that hangs is ended and fails."""
FAILED = 1
"""Exit code of pytest when tests ran and some failed; others mean that nothing was tested."""
MUTATIONS = mutations()


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the tree with its compiled kernel, and its byte code, so that only a broken file is compiled again."""
    to = tmp_path_factory.mktemp("tree")
    for name in FOLDERS:
        shutil.copytree(ROOT / name, to / name, ignore=shutil.ignore_patterns("*.so", "build"))
    shutil.copy2(ROOT / "pyproject.toml", to)
    kernel = importlib.util.find_spec("talc._kernel")
    assert kernel is not None
    assert kernel.origin is not None
    shutil.copy2(kernel.origin, to / "talc")
    return to


@pytest.fixture(scope="module")
def forks() -> Iterator[ForkedTests]:
    with ForkedTests() as program:
        yield program


@pytest.mark.slow
@pytest.mark.parametrize("mutation", MUTATIONS, ids=[f"{m.function}-{i}" for i, m in enumerate(MUTATIONS)])
def test_without_the_code_behind_a_promise_its_test_fails(mutation: Mutation, tree: Path, forks: ForkedTests) -> None:
    broken = tree / mutation.file
    broken.write_text(mutation.applied(), encoding="utf-8")
    try:
        done = forks.run(tree, mutation.test, LIMIT_S)
    finally:
        shutil.copy2(ROOT / mutation.file, broken)
    assert done.code == FAILED, f"{mutation.promise}: broken, and its test does not fail:\n{done.output[-3000:]}"


@pytest.mark.slow
def test_the_copy_is_what_runs(tree: Path, forks: ForkedTests) -> None:
    """A test passes in the unbroken copy, and it tests the copy's code, in other processes too."""
    test = tree / "tests" / "test_where.py"
    test.write_text(
        "import subprocess, sys\n"
        "WHERE = '''import gateway, drivers, talc._kernel, simulators, tests.benches, pathlib\n"
        "here = pathlib.Path.cwd()\n"
        "found = [gateway, drivers, talc._kernel, simulators, tests.benches]\n"
        "places = [m.__file__ or next(iter(m.__path__)) for m in found]\n"
        "assert all(pathlib.Path(place).is_relative_to(here) for place in places), places\n"
        "'''\n"
        "def test_where() -> None:\n"
        "    exec(WHERE, {})\n"
        "    subprocess.run([sys.executable, '-c', WHERE], check=True)\n"
    )
    done = forks.run(tree, "tests/test_where.py", LIMIT_S)
    test.unlink()
    assert done.code == 0, done.output


@pytest.mark.slow
def test_a_test_that_hangs_is_ended(tree: Path, forks: ForkedTests) -> None:
    test = tree / "tests" / "test_hangs.py"
    test.write_text("import time\ndef test_hangs() -> None:\n    time.sleep(1000.0)\n")
    done = forks.run(tree, "tests/test_hangs.py", 1.0)
    test.unlink()
    assert done.code is None
