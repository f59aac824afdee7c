"""No test waits for a time in the hope that something happens meanwhile."""

import ast
from pathlib import Path

TESTS = Path(__file__).parent
TIMES = ("pytest.mark.simulated_time", "pytest.mark.realtime")


def fixed_sleeps(text: str) -> list[int]:
    """Lines that sleep in real time, neither between two looks at a condition nor with a comment that says why."""
    lines, found = text.splitlines(), []

    def visit(node: ast.AST, marked: bool, looking: bool) -> None:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            marked = marked or any(ast.unparse(mark).startswith(TIMES) for mark in node.decorator_list)
        looking = looking or isinstance(node, ast.While) or can_end_early(node)
        if isinstance(node, ast.Call) and ast.unparse(node.func) in ("asyncio.sleep", "time.sleep", "sleep"):
            long = ast.unparse(node.args[0]) not in ("0", "0.0")
            if long and not marked and not looking and "  # " not in lines[node.lineno - 1]:
                found.append(node.lineno)
        for child in ast.iter_child_nodes(node):
            visit(child, marked, looking)

    tree = ast.parse(text)
    module = [ast.unparse(node.value) for node in tree.body if isinstance(node, ast.Assign) and is_mark(node)]
    visit(tree, any(time in mark for mark in module for time in TIMES), False)
    return found


def can_end_early(node: ast.AST) -> bool:
    """Whether it is a loop that ends when what it waits for is there."""
    ends = ast.Break | ast.Return
    return isinstance(node, ast.For | ast.AsyncFor) and any(isinstance(inside, ends) for inside in ast.walk(node))


def is_mark(node: ast.Assign) -> bool:
    return ast.unparse(node.targets[0]) == "pytestmark"


def test_what_counts_as_a_fixed_sleep() -> None:
    assert fixed_sleeps("def test():\n    time.sleep(0.1)\n") == [2]
    assert fixed_sleeps("async def test():\n    await asyncio.sleep(1)\n    assert done\n") == [2]
    assert fixed_sleeps("def test():\n    while not done:\n        time.sleep(0.1)\n") == []
    assert fixed_sleeps("def test():\n    for _ in range(3):\n        time.sleep(0.1)\n") == [3]
    assert (
        fixed_sleeps("def test():\n    for _ in many:\n        if done:\n            break\n        sleep(1)\n") == []
    )
    assert fixed_sleeps("def test():\n    time.sleep(0.1)  # its pace\n") == []
    assert fixed_sleeps("@pytest.mark.simulated_time\nasync def test():\n    await asyncio.sleep(1)\n") == []
    assert fixed_sleeps("pytestmark = pytest.mark.realtime\n\n\ndef test():\n    time.sleep(1)\n") == []


def test_no_test_sleeps_for_luck() -> None:
    """Benches set the pace of what they emulate; here it is the tests themselves."""
    files = {file: text for file in TESTS.rglob("test_*.py") if "sleep(" in (text := file.read_text("utf-8"))}
    assert len(files) > 20, "the tests were found"
    found = {str(file.relative_to(TESTS)): lines for file, text in files.items() if (lines := fixed_sleeps(text))}
    assert found == {}
