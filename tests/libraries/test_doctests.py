"""The examples in talc's docstrings, and on its page, give what they say."""

import doctest
import pkgutil
from importlib import import_module
from pathlib import Path

import pytest

import talc

MODULES = sorted(m.name for m in pkgutil.walk_packages(talc.__path__, "talc.") if not m.name.endswith("_kernel"))
SHOWN = (
    "talc.estimators.group_lasso_arx",
    "talc.estimators.learner",
    "talc.estimators.rehearsal",
    "talc.indicators",
    "talc.kinematics",
    "talc.probing",
)


@pytest.mark.parametrize("name", MODULES)
def test_examples_give_what_they_say(name: str) -> None:
    found = doctest.testmod(import_module(name))
    assert found.failed == 0
    assert found.attempted or name not in SHOWN


def test_the_page_gives_what_it_says() -> None:
    found = doctest.testfile(str(Path(__file__).parents[2] / "docs" / "library.md"), module_relative=False)
    assert found.failed == 0
    assert found.attempted > 15
