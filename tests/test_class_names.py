"""A class or type name means one thing in the whole tree, with or without an underscore before it.

Examples are exempt: each is independent, and can share no class with the tree.
"""

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
ROOMS = ("talc", "drivers", "gateway", "simulators", "studies", "benchmarks", "deploy", "tests")


def types(file: Path) -> Iterator[tuple[str, str]]:
    """Name (without underscores) and definition of each class, type alias and type variable of a module."""
    for node in ast.parse(file.read_text("utf-8")).body:
        match node:
            case ast.ClassDef(name=name):
                yield name.lstrip("_"), f"class {file}"
            case ast.Assign(targets=[ast.Name(id=name)], value=value) if is_type_name(name.lstrip("_")):
                text = ast.unparse(value)
                yield name.lstrip("_"), "any type" if text.startswith("TypeVar(") else text


def is_type_name(name: str) -> bool:
    return name[:1].isupper() and not name.isupper()


def test_no_two_types_have_one_name() -> None:
    """The same alias may stand in two rooms that do not know each other: that is still one meaning."""
    looks, places, meanings = defaultdict(list), defaultdict(set), defaultdict(set)
    for room in ROOMS:
        for file in (ROOT / room).rglob("*.py"):
            for name in re.findall(r"(?m)^(?:class )?_*(\w+)(?: *=|[(:])", file.read_text("utf-8")):
                if is_type_name(name):
                    looks[name].append(file)
    assert len(looks) > 600, "the rooms were found"
    # A text may look like a type, and only parsing the file tells; parsing all of them takes seconds.
    for file in {file for files in looks.values() if len(files) > 1 for file in files}:
        for name, meaning in types(file):
            places[name].add(str(file.relative_to(ROOT)))
            meanings[name].add(meaning)
    assert {name: sorted(places[name]) for name in places if len(meanings[name]) > 1} == {}
