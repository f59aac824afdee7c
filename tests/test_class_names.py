"""A class name means one thing in the whole tree: no two rooms, and no two benches, use one for different things."""

import ast
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[1]
ROOMS = ("talc", "drivers", "gateway", "simulators", "studies", "benchmarks", "deploy", "tests/benches")


def classes(file: Path) -> list[str]:
    """The classes of a module, private ones too."""
    return [node.name for node in ast.parse(file.read_text("utf-8")).body if isinstance(node, ast.ClassDef)]


def test_no_two_classes_have_one_name() -> None:
    places = defaultdict(list)
    for room in ROOMS:
        for file in (ROOT / room).rglob("*.py"):
            for name in classes(file):
                places[name].append(str(file.relative_to(ROOT)))
    assert len(places) > 300, "the rooms were found"
    assert {name: files for name, files in places.items() if len(files) > 1} == {}
