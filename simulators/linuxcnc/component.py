"""The real-time component talc_errors beside LinuxCNC's own, in a folder that takes the place of theirs.

Nothing is installed: LinuxCNC sees the folder in its own namespace only.
"""

import shutil
import subprocess
from pathlib import Path

MODULES = Path("/usr/lib/linuxcnc/modules")
"""Where LinuxCNC looks for real-time components, and nowhere else."""


def modules(folder: Path, files: Path) -> None:
    """LinuxCNC's real-time components and ours, in `folder`, which is made. files: deploy/nc/linuxcnc.

    Raises OSError with what the compiler says.
    """
    shutil.copytree(MODULES, folder)
    for source in files.glob("talc_errors.*"):
        shutil.copy(source, folder)
    done = subprocess.run(
        ["halcompile", "--compile", "talc_errors.comp"], cwd=folder, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise OSError(f"halcompile talc_errors.comp: {done.stdout}{done.stderr}")
