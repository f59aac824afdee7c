"""Where LinuxCNC is not installed, its demo says what to install."""

import subprocess
import sys
from pathlib import Path


def test_without_linuxcnc_the_demo_names_the_package(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "gateway", "demo", "--nc", "linuxcnc", "--folder", str(tmp_path)],
        capture_output=True,
        text=True,
        timeout=60.0,
        check=False,
        env={"PATH": str(tmp_path)},
    )
    assert done.returncode == 3
    assert "LinuxCNC's linuxcnc is not installed here" in done.stderr
    assert "apt-get install linuxcnc-uspace" in done.stderr
    assert "Traceback" not in done.stderr
