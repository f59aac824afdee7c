"""Code that several test files share is in tests/benches; no test file is imported by another.

Tests use what a room offers, nothing private. A bench that needs a different behaviour changes the source
(tests/benches/changed_source.py).
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.benches.private_names import private_of_others

TESTS = Path(__file__).parent
FILES = sorted(TESTS.rglob("*.py"))
PRIVATE = re.compile(r"(?:\w*\.)*_(?!_)\w+")
"""A private attribute's name, with the names before it or without."""
KERNEL = "talc._kernel"
"""A module that is loaded by this name, because it is compiled."""
CLOCK = "from tests.benches.wire_clock import WireClock\n"
"""A class with private names, its own and those of another module."""
OVERRIDES = "A: _now overrides another's"
PROGRAM = re.compile(r"\b(?:from|import) tests\.[\w.]*\btest_\w+")
"""An import of a test file in the text of a program that a test runs."""
PART_OF_A_TEXT = ("startswith", "endswith", "removeprefix", "removesuffix")


def imported(file: Path) -> set[str]:
    """Last names of all modules that the file imports, in any form of the statement."""
    names = set()
    for node in ast.walk(ast.parse(file.read_text("utf-8"))):
        if isinstance(node, ast.ImportFrom):
            names |= {node.module or "", *(alias.name for alias in node.names)}
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    return {name.rpartition(".")[2] for name in names}


def named_in_texts(source: str) -> list[str]:
    """Texts that are a private name, as patch.object, setattr or getattr take it, also in a table.

    In an f-string, those that follow a dot.
    """
    return [text for text in _texts(ast.parse(source)) if PRIVATE.fullmatch(text) and text != KERNEL]


def _texts(node: ast.AST) -> Iterator[str]:
    match node:
        case ast.Constant(str(text)):
            yield text
        case ast.JoinedStr(parts):
            inner = [(isinstance(part, ast.Constant), text) for part in parts for text in _texts(part)]
            yield from (text for is_part, text in inner if not is_part or "." in text)
        case ast.Call(ast.Attribute(text, name)) if name in PART_OF_A_TEXT:
            yield from _texts(text)
        case _:
            yield from (text for child in ast.iter_child_nodes(node) for text in _texts(child))


def test_no_file_imports_another_ones_tests() -> None:
    tests = {path.stem for path in TESTS.rglob("test_*.py")}
    mention = re.compile(rf"\b(?:{'|'.join(tests)})\b")
    suspects = [file for file in FILES if mention.search(file.read_text("utf-8"))]
    assert len(suspects) > 10, "docstrings mention test files"
    assert [str(file.relative_to(TESTS)) for file in suspects if not imported(file).isdisjoint(tests)] == []


def test_no_program_in_a_text_imports_tests() -> None:
    own = "from tests." + "gateway.test_events import X"
    assert PROGRAM.search(f"import asyncio; {own}")
    assert [str(file.relative_to(TESTS)) for file in FILES if PROGRAM.search(file.read_text("utf-8"))] == []


def test_no_file_is_excused_for_using_what_is_private() -> None:
    """Ruff reports it (SLF001)."""
    excused = re.compile(r"noqa:.*\bSLF(?:001)?\b")
    assert [str(file.relative_to(TESTS)) for file in FILES if excused.search(file.read_text("utf-8"))] == []


def test_no_file_names_what_is_private_in_a_text() -> None:
    found = {str(file.relative_to(TESTS)): named_in_texts(file.read_text("utf-8")) for file in FILES}
    assert {file: names for file, names in found.items() if names} == {}


@pytest.mark.parametrize(
    "source",
    [
        "patch.object(link, 'X')",
        "DEFECTS = {'a': ((GridLoop, 'X', instead),)}",
        "monkeypatch.setattr('gateway.storage.writer.X', 2.0)",
        "for name in ('X',): setattr(module, name, 1)",
        "monkeypatch.setattr(f'{room}.X', 1)",
        "getattr(f'{name}', 'X').endswith('Y')",
    ],
)
def test_a_private_name_in_a_text_is_found(source: str) -> None:
    private = "_" + "answer_at"
    (found,) = named_in_texts(source.replace("X", private))
    assert found.endswith(private)
    assert named_in_texts(source) == []


@pytest.mark.parametrize("source", ["f'{name}_um'", "name.endswith('_um')", "'__init__'", "'a _um'", "'talc._kernel'"])
def test_no_private_name_is_found_in_a_text_that_only_contains_an_underscore(source: str) -> None:
    assert named_in_texts(source) == []


def test_no_file_imports_inherits_or_overrides_what_is_private() -> None:
    found = {str(file.relative_to(TESTS)): private_of_others(file.read_text("utf-8")) for file in FILES}
    assert {file: names for file, names in found.items() if names} == {}


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ("from talc.X import Progress", "talc.X.Progress"),
        ("from talc import X", "talc.X"),
        ("import talc.X as kernel", "talc.X"),
        ("one.__class__ = Other", "one.__class__ ="),
        ("class A(B):\n def f(self): return self.X", "A: X is not defined here"),
        ("class A(B):\n async def f(self): await super().X()", "A: X is not defined here"),
        (f"{CLOCK}class A(WireClock):\n def _sleepers(self): pass", "A: _sleepers overrides another's"),
        (f"{CLOCK}class B(WireClock): pass\nclass A(B):\n def f(self): self._now = 1", OVERRIDES),
        ("import tests.benches.wire_clock\nclass A(tests.benches.wire_clock.WireClock):\n _now = 1", OVERRIDES),
        ("import tests.benches.wire_clock as c\nclass A(c.WireClock):\n _now: int", OVERRIDES),
    ],
)
def test_what_is_private_and_another_file_s_is_found(source: str, said: str) -> None:
    own = "_" + "own"
    assert private_of_others(source.replace("X", own)) == [said.replace("X", own)]


@pytest.mark.parametrize(
    "source",
    [
        "from talc.training import Progress",
        "class A(B):\n def _x(self): return self._y()\nclass B:\n def _y(self): pass",
        "class A(B[int]):\n def __init__(self): self._x = self._y\n _y: int = 1",
        f"{CLOCK}class A(WireClock):\n def rest(self): self._mine = super().__init__()",
    ],
)
def test_private_names_of_the_file_itself_are_allowed(source: str) -> None:
    assert private_of_others(source) == []
