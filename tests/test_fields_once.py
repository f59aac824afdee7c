"""No class of the gateway lists another one's fields, with their types, again: it derives from it, or holds one."""

import ast
from collections.abc import Iterator
from itertools import permutations
from pathlib import Path

GATEWAY = Path(__file__).parents[1] / "gateway"
FEWEST = 4
"""Fewer may agree by chance, such as a value with its unit and its time."""


def classes() -> Iterator[tuple[str, dict[str, str]]]:
    """Name, and field to type, of each class with so many fields of its own."""
    for file in sorted(GATEWAY.rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                fields = {
                    item.target.id: ast.unparse(item.annotation)
                    for item in node.body
                    if isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name)
                }
                if len(fields) >= FEWEST:
                    yield node.name, fields


def test_no_class_lists_the_fields_of_another() -> None:
    found = dict(classes())
    assert len(found) > 100
    repeated = [(one, other) for one, other in permutations(found, 2) if found[one].items() <= found[other].items()]
    assert repeated == []
