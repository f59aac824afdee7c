"""Every source change that a bench or test plants quotes text that occurs once in its module.

The benches find that out when they run; most of them are slow.
"""

import ast
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

TESTS = Path(__file__).parent


def planted(source: str) -> Iterator[tuple[int, str, str]]:
    """Line, module and quoted text of each `SourceChange(module, "text", ...)`."""
    nodes = list(ast.walk(ast.parse(source)))
    modules = {
        alias.asname or alias.name: f"{node.module}.{alias.name}"
        for node in nodes
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    for node in nodes:
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "SourceChange":
            module, text = (ast.unparse(node.args[0]), ast.literal_eval(node.args[1]))
            yield node.lineno, modules[module], text


def source_of(module: str) -> str:
    found = find_spec(module)
    assert found is not None, f"there is no module {module}"
    return Path(found.origin or "").read_text(encoding="utf-8")


def test_each_planted_change_quotes_text_that_occurs_once() -> None:
    wrong, count = [], 0
    for file in sorted(TESTS.rglob("*.py")):
        text = file.read_text(encoding="utf-8")
        if "SourceChange(" in text:
            for line, module, quoted in planted(text):
                count += 1
                if (times := source_of(module).count(quoted)) != 1:
                    wrong.append(f"{file.relative_to(TESTS)}:{line}: {quoted!r} occurs {times} times in {module}")
    assert count > 30, "the changes were found"
    assert wrong == []


def test_a_planted_change_is_found_with_its_module() -> None:
    source = 'from gateway.storage import store\nX = (SourceChange(store, "a" "b", "c"),)\n'
    assert list(planted(source)) == [(2, "gateway.storage.store", "ab")]
