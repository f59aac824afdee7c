"""What the workers of a test run share is made once."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier

import pytest

from tests.benches.made_once import made_once, run_folder


def test_those_that_ask_at_the_same_moment_get_the_same(tmp_path: Path) -> None:
    made: list[Path] = []
    together = Barrier(4)

    def make(folder: Path) -> None:
        made.append(folder)
        (folder / "whole").touch()

    def ask(_: int) -> bool:
        together.wait()
        return (made_once(tmp_path / "it", make) / "whole").exists()

    with ThreadPoolExecutor(4) as workers:
        assert all(workers.map(ask, range(4)))
    assert len(made) == 1


def test_after_a_failure_the_next_begins_again(tmp_path: Path) -> None:
    def fails(folder: Path) -> None:
        (folder / "half").touch()
        raise OSError("the disk is full")

    with pytest.raises(OSError, match="full"):
        made_once(tmp_path / "it", fails)
    assert not (tmp_path / "it").exists()
    assert list(made_once(tmp_path / "it", lambda folder: (folder / "whole").touch()).iterdir()) == [
        tmp_path / "it" / "whole"
    ]


def test_the_folder_is_that_of_this_run(
    tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = tmp_path_factory.getbasetemp()
    monkeypatch.delenv("PYTEST_XDIST_WORKER", raising=False)
    assert run_folder(tmp_path_factory) == own
    monkeypatch.setenv("PYTEST_XDIST_WORKER", "gw0")
    assert run_folder(tmp_path_factory) == own.parent
