"""The demo with LinuxCNC: what it says where that is not installed, and how it reads a silent gateway's offsets."""

import math
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from gateway.cli.main import main
from gateway.demo.demo_linuxcnc import silence


def test_without_linuxcnc_the_demo_names_the_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    answer = CliRunner().invoke(main, ["demo", "--nc", "linuxcnc", "--folder", str(tmp_path)])
    assert answer.exit_code == 3
    assert isinstance(answer.exception, SystemExit), "no traceback"
    assert "LinuxCNC's linuxcnc is not installed here" in answer.stderr
    assert "apt-get install linuxcnc-uspace" in answer.stderr


@pytest.mark.parametrize(
    ("x_um", "expected"),
    [((30.0, 30.0, 15.0, 0.0), (1.0, 3.0)), ((30.0, 30.0, 15.0, 15.0), (1.0, math.inf))],
    ids=["to zero", "not to zero"],
)
def test_silence_is_when_the_offsets_were_last_held_and_first_at_zero(
    x_um: tuple[float, ...], expected: tuple[float, float]
) -> None:
    rows = np.zeros((4, 4))
    rows[:, 0] = range(4)
    rows[:, 1] = x_um
    assert silence(rows) == expected
