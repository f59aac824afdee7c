"""`TOOL/python mutants_of.py MODULE`: every mutant of a module that cosmic-ray makes, one JSON line each.

Runs in the environment of cosmic-ray, which knows nothing of this project. Annotations are left out: what breaks there
is no behaviour.
"""

import ast
import json
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path


def annotations(source: str) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Begin and end of each: line from 1, column from 0."""
    found: list[ast.expr | None] = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            found.append(node.returns)
        elif isinstance(node, ast.arg | ast.AnnAssign):
            found.append(node.annotation)
    return [
        ((each.lineno, each.col_offset), (each.end_lineno or each.lineno, each.end_col_offset or 0))
        for each in found
        if each is not None
    ]


def mutants(source: str) -> Iterator[tuple[str, int, int, str]]:
    """Operator, occurrence, line and mutated source."""
    from cosmic_ray.ast import ast_nodes, get_ast  # only in its own environment
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.plugins import get_operator, operator_names

    tree, within = get_ast(source), annotations(source)
    for name in operator_names():
        kind = get_operator(name)
        if kind.arguments():
            continue
        operator = kind()
        places = [place for node in ast_nodes(tree) for place, _ in operator.mutation_positions(node)]
        for occurrence, place in enumerate(places):
            if not any(begin <= tuple(place) < end for begin, end in within):
                with suppress(AttributeError):  # cosmic-ray cannot replace an exception that has a dot in its name
                    yield name.removeprefix("core/"), occurrence, place[0], mutate_code(source, operator, occurrence)


if __name__ == "__main__":
    for name_, occurrence_, line_, mutated in mutants(Path(sys.argv[1]).read_text(encoding="utf-8")):
        print(json.dumps({"operator": name_, "occurrence": occurrence_, "line": line_, "source": mutated}))
