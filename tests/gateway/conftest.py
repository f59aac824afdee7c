"""Fixtures of the tests of third-party packages, in several rooms."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.benches.extension_package import example_files, install


@pytest.fixture
def no_package_stays_loaded() -> Iterator[None]:
    """Each test loads its own module of the same name."""
    before = set(sys.modules)
    yield
    for name in set(sys.modules) - before:
        if name.split(".")[0] in ("talc_example", "other_package"):
            del sys.modules[name]


@pytest.fixture
def example(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder in which the package of examples/extension is installed."""
    install(example_files(), tmp_path / "site")
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    return tmp_path
