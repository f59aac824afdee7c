"""Outside of their family, bus settings are made by what reports a mistake in one line that names the field."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.base import SetupError
from drivers.build import BUS_KINDS
from gateway.scan import plan

GATEWAY = Path(__file__).parents[3] / "gateway"


def files() -> Iterator[tuple[str, ast.Module]]:
    for file in sorted(GATEWAY.rglob("*.py")):
        yield str(file.relative_to(GATEWAY)), ast.parse(file.read_text(encoding="utf-8"))


def test_no_settings_of_a_bus_are_made_where_a_mistake_would_be_a_traceback() -> None:
    classes = {settings.__name__ for settings in BUS_KINDS.values()}
    made = [
        f"{name}:{node.lineno}: {ast.unparse(node.func)}"
        for name, tree in files()
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and ast.unparse(node.func).rpartition(".")[2] in classes
    ]
    assert made == [], "use drivers.problems.read_settings"


@pytest.mark.parametrize(("field", "timeout_s"), [("port: '/'", 1.0), ("timeout_s: 61", 61.0)])
def test_a_plan_of_what_no_bus_could_have_names_the_field(field: str, timeout_s: float) -> None:
    with pytest.raises(SetupError, match=f"^{field}"):
        plan("/" if "port" in field else "/dev/null", bauds=(9600,), parities=("N",), units=(1,), me_bauds=(),
             me_addresses=(), timeout_s=timeout_s)  # fmt: skip
