"""Each row of the tables in docs/safety.md names tests that exist, and code that can be broken to make them fail.

That they do fail is the subject of test_safety_mutations, which takes minutes.
"""

import ast
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

from tests.benches.safety_page import ROOT, Mutation, mutations, named_in, promises

MUTATIONS = mutations()


@cache
def functions(path: Path) -> set[str]:
    """Names of a file's functions."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)}


def code_of_python(source: str) -> str:
    return ast.dump(ast.parse(source))


def code_of_c(source: str) -> list[str]:
    """Its tokens, without comments."""
    return re.sub(r"/\*.*?\*/|//[^\n]*", " ", source, flags=re.DOTALL).split()


def test_every_test_that_the_safety_page_names_exists() -> None:
    every = [named for promise in promises() for named in promise.named]
    assert len({name for named in every for name in named.functions}) > 60
    wanted = [({f"test_{name}" for name in named.functions}, named) for named in every]
    assert [named for tests, named in wanted if not any(tests <= functions(path) for path in named.paths)] == []


@pytest.mark.parametrize("column", ["`test_a`", "`test_a` in `tests`", "`test_a`: `b`, `test_c`; `test_d`", "a: `b`"])
def test_a_row_that_names_a_file_without_functions_is_refused(column: str) -> None:
    with pytest.raises(ValueError, match="expected `file`: `function`"):
        named_in(column)


def test_a_row_names_the_functions_of_each_file() -> None:
    first, second = named_in("`nc/test_boundary`: `a`, `b`; `test_training` in `tests/talc`: `c`")
    assert (first.file, sorted(first.functions), sorted(second.functions)) == ("nc/test_boundary", ["a", "b"], ["c"])
    assert first.paths == [ROOT / "tests" / "gateway" / "nc" / "test_boundary.py"]
    assert second.paths == [ROOT / "tests" / "talc" / "test_training.py"]


def test_every_test_in_a_line_has_a_mutation_that_makes_it_fail() -> None:
    """A mutation of this row: what breaks another promise may leave this one unproved."""
    lacking = {}
    for promise in promises():
        proved = {mutation.function for mutation in MUTATIONS if promise.text.startswith(mutation.promise)}
        lacking[promise.text] = promise.tests - proved
    assert {text: sorted(names) for text, names in lacking.items() if names} == {}


def test_every_promise_has_a_mutation_and_every_mutation_one_promise() -> None:
    found = promises()
    assert len(found) > 40
    broken = [[p.text for p in found if p.text.startswith(mutation.promise)] for mutation in MUTATIONS]
    assert [m.promise for m, texts in zip(MUTATIONS, broken, strict=True) if len(texts) != 1] == []
    assert {p.text for p in found} - {text for texts in broken for text in texts} == set()


@pytest.mark.parametrize("mutation", MUTATIONS, ids=[f"{m.function}-{i}" for i, m in enumerate(MUTATIONS)])
def test_a_mutation_can_be_applied_and_its_test_stands_in_its_line(mutation: Mutation) -> None:
    before, after = (ROOT / mutation.file).read_text(encoding="utf-8"), mutation.applied()
    code = code_of_python if mutation.file.endswith(".py") else code_of_c
    assert code(after) != code(before), "what is broken must be code"
    [promise] = [p for p in promises() if p.text.startswith(mutation.promise)]
    assert mutation.function in promise.tests
    assert f"test_{mutation.function}" in functions(ROOT / re.split("::", mutation.test)[0])


def test_every_test_of_a_mutation_is_collected_with_its_parameters() -> None:
    command = [sys.executable, "-m", "pytest", "--collect-only", "-q", "-p", "no:cacheprovider"]
    tests = sorted({mutation.test for mutation in MUTATIONS})
    done = subprocess.run([*command, *tests], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, (done.stdout + done.stderr)[-3000:]
