"""Each row of the tables in docs/safety.md names tests that exist, and code that can be broken to make them fail.

That they do fail is the subject of test_safety_mutations, which takes minutes.
"""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

from tests.benches.safety_page import ROOT, Mutation, mutations, promises

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


def named_functions() -> frozenset[str]:
    """Test functions that the page names, without `test_`; it also names files."""
    named = {name for promise in promises() for name in promise.tests}
    paths = (ROOT / "tests").rglob("test_*.py")
    looks = {path for path in paths if named & set(re.findall(r"def test_(\w+)", path.read_text(encoding="utf-8")))}
    tests = {name.removeprefix("test_") for path in looks for name in functions(path) if "test_" in name}
    return frozenset(named & tests)


def test_every_test_that_the_safety_page_names_exists() -> None:
    files = {path.stem for path in (ROOT / "tests").rglob("test_*.py")}  # several may have one name
    others = {name for promise in promises() for name in promise.tests} - named_functions()
    assert len(named_functions()) > 60
    assert {name for name in others if not (Path(name).name in files or (ROOT / name).is_dir())} == set()


def test_every_test_in_a_line_has_a_mutation_that_makes_it_fail() -> None:
    """A mutation of this row: what breaks another promise may leave this one unproved."""
    tests = named_functions()
    lacking = {}
    for promise in promises():
        proved = {mutation.function for mutation in MUTATIONS if promise.text.startswith(mutation.promise)}
        lacking[promise.text] = (promise.tests & tests) - proved
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
