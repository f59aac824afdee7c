"""The import linter's contracts notice what they are for: each import here is made in a copy of the tree's graph."""

from collections.abc import Callable
from copy import deepcopy
from pathlib import Path

import grimp
import pytest
from importlinter.application.use_cases import read_user_options
from importlinter.configuration import configure
from importlinter.contracts.acyclic_siblings import AcyclicSiblingsContract
from importlinter.contracts.forbidden import ForbiddenContract
from importlinter.contracts.independence import IndependenceContract
from importlinter.contracts.layers import LayersContract
from importlinter.contracts.protected import ProtectedContract
from importlinter.domain.contract import Contract

ROOT = Path(__file__).parents[1]
KINDS: dict[str, Callable[..., Contract]] = {
    "acyclic_siblings": AcyclicSiblingsContract,
    "forbidden": ForbiddenContract,
    "independence": IndependenceContract,
    "layers": LayersContract,
    "protected": ProtectedContract,
}


@pytest.fixture(scope="module")
def tree() -> grimp.ImportGraph:
    configure()
    options = read_user_options(str(ROOT / "pyproject.toml"))
    rooms = options.session_options["root_packages"]
    return grimp.build_graph(*rooms, include_external_packages=True, cache_dir=None)


def broken(graph: grimp.ImportGraph) -> set[str]:
    """Names of the contracts that the graph breaks."""
    options = read_user_options(str(ROOT / "pyproject.toml"))
    found = set()
    for given in options.contracts_options:
        contract = KINDS[given["type"]](given["name"], options.session_options, given)
        if not contract.check(deepcopy(graph), verbose=False).kept:
            found.add(given["name"])
    return found


def test_the_tree_keeps_every_contract(tree: grimp.ImportGraph) -> None:
    assert broken(tree) == set()


LISTENERS = ("gateway.outlets.feed", "gateway.heard.site", "gateway.umati.server", "gateway.web.app")


@pytest.mark.parametrize(
    ("importer", "imported"),
    [
        *((room, other) for room in LISTENERS for other in ("service", "past", "watches", "scan", "nc", "storage")),
        *(("gateway.client.machine", other) for other in ("service", "past", "watches", "scan", "nc", "storage")),
        *(("gateway.collect.collector", other) for other in ("service", "past", "watches", "scan", "nc")),
    ],
)
def test_a_reader_that_calls_the_service_is_noticed(importer: str, imported: str, tree: grimp.ImportGraph) -> None:
    graph = deepcopy(tree)
    graph.add_import(importer=importer, imported=f"gateway.{imported}")
    assert broken(graph)


@pytest.mark.parametrize(
    "importer", ["gateway.cli.condition.doctor", "gateway.cli.running.run", "gateway.cli.main", "gateway.service"]
)
def test_a_command_that_needs_no_simulator_and_imports_one_is_noticed(importer: str, tree: grimp.ImportGraph) -> None:
    graph = deepcopy(tree)
    graph.add_import(importer=importer, imported="simulators.devices")
    assert broken(graph)


@pytest.mark.parametrize(
    ("importer", "imported"),
    [
        ("conventions.exits", "running.run"),
        ("running.run", "condition.status"),
        ("running.serving", "emulated.demo"),
        ("beside.web", "recorded.report"),
        ("recorded.commands", "commissioning.scan"),
        ("condition.status", "running.memory"),  # what others may use, but not this module
        ("emulated.demo", "main"),
    ],
)
def test_an_arrow_between_folders_of_commands_that_must_not_be_is_noticed(
    importer: str, imported: str, tree: grimp.ImportGraph
) -> None:
    graph = deepcopy(tree)
    assert {f"gateway.cli.{importer}", f"gateway.cli.{imported}"} <= graph.modules
    graph.add_import(importer=f"gateway.cli.{importer}", imported=f"gateway.cli.{imported}")
    assert broken(graph)


@pytest.mark.parametrize(
    ("importer", "imported"),
    [
        *((room, "tests") for room in ("talc.arx", "gateway.service", "simulators.clock", "studies.page")),
        ("benchmarks.__main__", "tests"),
        ("benchmarks.__main__", "gateway.web"),
        ("benchmarks.__main__", "gateway.cli.running.run"),
        ("studies.page", "gateway.config"),
        ("studies.page", "benchmarks"),
        *((room, "studies") for room in ("talc.arx", "drivers.base", "gateway.service", "simulators.clock")),
    ],
)
def test_an_arrow_between_rooms_that_must_not_be_is_noticed(
    importer: str, imported: str, tree: grimp.ImportGraph
) -> None:
    graph = deepcopy(tree)
    assert importer in graph.modules
    if imported == "tests":
        graph.add_module("tests", is_squashed=True)
    graph.add_import(importer=importer, imported=imported)
    assert broken(graph)
