"""Where LinuxCNC is not installed, its demo says what to install."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from gateway.cli import main


def test_without_linuxcnc_the_demo_names_the_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    answer = CliRunner().invoke(main, ["demo", "--nc", "linuxcnc", "--folder", str(tmp_path)])
    assert answer.exit_code == 3
    assert isinstance(answer.exception, SystemExit), "no traceback"
    assert "LinuxCNC's linuxcnc is not installed here" in answer.stderr
    assert "apt-get install linuxcnc-uspace" in answer.stderr
