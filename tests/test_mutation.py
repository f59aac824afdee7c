"""The bench that tries mutants: it tells a killed one from a survivor, and its tables name what exists."""

import subprocess
import sys

import pytest

from tests.benches.mutants_of import annotations
from tests.benches.mutation import KILLED, MODULES, ROOT, SURVIVED, changed, explained, file_of

TRIED = """
from tests.benches.mutation import MODULES, file_of, tested
source = file_of("gateway.nc.motion").read_text("utf-8")
for text, other in (("", ""), ("now - since >= self._longest", "now - since > self._longest")):
    print(tested("gateway.nc.motion", source.replace(text, other), MODULES["gateway.nc.motion"], 600, 600.0)[0])
"""


def test_a_mutant_that_a_test_notices_is_killed_and_the_module_itself_is_not() -> None:
    done = subprocess.run([sys.executable, "-c", TRIED], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.stdout.split() == [SURVIVED, KILLED], done.stderr


@pytest.mark.parametrize("module", MODULES)
def test_every_module_has_tests_that_exist(module: str) -> None:
    assert file_of(module).is_file()
    assert MODULES[module]
    assert [test for test in MODULES[module] if not (ROOT / test).is_file()] == []


def test_every_explained_survivor_is_about_lines_that_exist() -> None:
    for survivor in explained():
        lines = {line.strip() for line in (ROOT / survivor.file).read_text("utf-8").splitlines()}
        assert survivor.before in lines, f"{survivor.file}: {survivor.before!r} has changed: try its mutants again"
        assert survivor.after != survivor.before
        assert survivor.reason


def test_what_differs_is_told_without_indentation() -> None:
    assert changed("if a:\n    b = 1\n    c = 2\n", "if a:\n    b = 3\n    c = 2\n") == ("b = 1", "b = 3")


def test_annotations_are_found_and_defaults_are_not_among_them() -> None:
    source = "def f(a: int | None = 1 | 2) -> str | None: ...\nx: int | None = 3 | 4\n"
    places = annotations(source)
    assert sorted(source.splitlines()[line - 1][begin:end] for (line, begin), (_, end) in places) == [
        "int | None", "int | None", "str | None",
    ]  # fmt: skip
