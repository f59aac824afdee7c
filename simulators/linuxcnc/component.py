"""The real-time component talc_errors beside LinuxCNC's own, in a folder that takes the place of theirs.

Nothing is installed: LinuxCNC sees the folder in its own namespace only.
"""

import shutil
import subprocess
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

MODULES = Path("/usr/lib/linuxcnc/modules")
"""Where LinuxCNC looks for real-time components, and nowhere else."""
MODULE = "talc_errors.so"


def modules(folder: Path, files: Path) -> None:
    """LinuxCNC's real-time components and ours, in `folder`, which is made. files: deploy/nc/linuxcnc.

    Raises OSError with what the compiler says.
    """
    shutil.copytree(MODULES, folder)
    sources = tuple((source.name, source.read_bytes()) for source in sorted(files.glob("talc_errors.*")))
    (folder / MODULE).unlink(missing_ok=True)
    (folder / MODULE).write_bytes(_compiled(sources))


@cache
def _compiled(sources: tuple[tuple[str, bytes], ...]) -> bytes:
    """The component, compiled once a process."""
    with TemporaryDirectory() as folder:
        for name, source in sources:
            (Path(folder) / name).write_bytes(source)
        done = subprocess.run(
            ["halcompile", "--compile", "talc_errors.comp"], cwd=folder, capture_output=True, text=True, check=False
        )
        if done.returncode:
            raise OSError(f"halcompile talc_errors.comp: {done.stdout}{done.stderr}")
        return (Path(folder) / MODULE).read_bytes()
