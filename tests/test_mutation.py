"""The bench that tries mutants distinguishes killed mutants from survivors, and its tables name what exists."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.benches.mutants_of import annotations
from tests.benches.mutated_functions import exchanges, is_another, statement_lines
from tests.benches.mutation import KILLED, MODULES, ROOT, SURVIVED, changed, explained, file_of, interval

TRIED = """
from tests.benches.mutation import MODULES, file_of, tested
source = file_of("gateway.nc.motion").read_text("utf-8")
for text, other in (("", ""), ("now - since >= self._longest", "now - since > self._longest")):
    print(tested("gateway.nc.motion", source.replace(text, other), MODULES["gateway.nc.motion"], 600, 600.0)[0])
"""

COLLECTED = """
from tests.benches.mutated_functions import Mutant
from tests.benches.mutation import file_of, try_collected
source = file_of("gateway.nc.motion").read_text("utf-8")
def changed(before, after):
    line = next(i for i, text in enumerate(source.splitlines(), 1) if before in text)
    return Mutant("", 0, line, source.replace(before, after))
mutants = [
    changed("now - since >= self._longest", "now - since > self._longest"),
    changed("self._looked_s = -math.inf", "self._looked_s = +math.inf"),
    changed("class Motion:", "class Motion(dict):"),
    changed("now - since >= self._longest", "now - since <= self._longest"),
]
def told(mutant, outcome, by):
    print(mutants.index(mutant), outcome, by.partition("::")[0], file=sys.stderr)
import sys
try_collected("gateway.nc.motion", mutants, float("inf"), told)
assert "gateway.nc.motion" not in sys.modules
"""


@pytest.mark.slow
def test_a_mutant_that_a_test_notices_is_killed_and_the_module_itself_is_not() -> None:
    done = subprocess.run([sys.executable, "-c", TRIED], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.stdout.split() == [SURVIVED, KILLED], done.stderr


@pytest.mark.slow
def test_mutants_within_functions_are_distinguished_with_tests_that_are_collected_once() -> None:
    done = subprocess.run([sys.executable, "-c", COLLECTED], cwd=ROOT, capture_output=True, text=True, check=False)
    told = [line.split() for line in done.stderr.splitlines() if line[:1].isdigit()]
    file = MODULES["gateway.nc.motion"][0]
    assert told == [["0", KILLED, file], ["1", SURVIVED], ["3", KILLED, file]], done.stderr
    assert done.returncode == 0


@pytest.mark.parametrize(
    ("after", "another"),
    [("x = 1 + 1  # two\n", False), ("x = 2\n", False), ("x = 2.0\n", True), ("x = True\n", True), ("x = +\n", False)],
)
def test_only_another_program_is_a_mutant(after: str, another: bool) -> None:
    assert is_another("x = 2\n", after) is another


@pytest.mark.parametrize(
    ("before", "after", "another"),
    [
        ("a is B.C", "a == B.C", False),
        ("f(B.C is not a)", "f(B.C != a)", False),
        ("x is y is B.C", "x is y == B.C", False),
        ("x is y is B.C", "x == y is B.C", True),
        ("a is D.C", "a == D.C", True),
        ("a is not B.C", "a == B.C", True),
        ("a is B.C", "a >= B.C", True),
    ],
)
def test_a_member_of_an_enumeration_is_a_single_object(before: str, after: str, another: bool) -> None:
    assert is_another(before, after, {"B"}) is another


CLASS = """
LIMIT = 3
class A:
    def f(self, x=0):
        return [y for y in (x, 1)]
    @property
    def g(self):
        return 2
"""


@pytest.mark.parametrize(
    ("before", "after", "functions"),
    [
        ("return 2", "return 3", [("A.g", 6)]),
        ("(x, 1)", "(x, 2)", [("A.f", 4)]),
        ("LIMIT = 3", "LIMIT = 4", None),
        ("x=0", "x=1", None),
        ("    @property\n", "    @classmethod\n", None),
    ],
)
def test_what_differs_within_functions_is_found(
    before: str, after: str, functions: list[tuple[str, int]] | None
) -> None:
    found = exchanges(CLASS, CLASS.replace(before, after), Path("a.py"))
    assert (found if found is None else [(name, line) for name, line, _ in found]) == functions


STATEMENTS = """if (a and
    b):
    c = [
        1,
    ]
match d:
    case 1:
        e()
try:
    f()
except (
    KeyError
):
    g()
"""


@pytest.mark.parametrize(
    ("line", "lines"),
    [(1, (1, 2)), (2, (1, 2)), (4, (3, 4, 5)), (6, (6,)), (7, (7,)), (8, (8,)), (12, (11, 12, 13)), (14, (14,))],
)
def test_a_line_belongs_to_its_innermost_statement_s_head(line: int, lines: tuple[int, ...]) -> None:
    assert tuple(statement_lines(STATEMENTS, line)) == lines


@pytest.mark.parametrize(("hits", "tries"), [(135, 150), (10, 10), (0, 7), (1, 2)])
def test_a_sample_says_how_sure_its_share_is(hits: int, tries: int) -> None:
    """The interval is the one that SciPy computes."""
    from scipy.stats import binomtest  # a second that only this test needs to spend

    expected = binomtest(hits, tries).proportion_ci(method="wilson")
    assert interval(hits, tries) == pytest.approx((expected.low, expected.high), abs=1e-6)


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


def test_lines_that_differ_are_shown_without_indentation() -> None:
    assert changed("if a:\n    b = 1\n    c = 2\n", "if a:\n    b = 3\n    c = 2\n") == ("b = 1", "b = 3")


def test_annotations_are_found_and_defaults_are_not_among_them() -> None:
    source = "def f(a: int | None = 1 | 2) -> str | None: ...\nx: int | None = 3 | 4\n"
    places = annotations(source)
    assert sorted(source.splitlines()[line - 1][begin:end] for (line, begin), (_, end) in places) == [
        "int | None", "int | None", "str | None",
    ]  # fmt: skip
