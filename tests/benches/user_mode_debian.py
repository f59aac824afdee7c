"""A Debian booted with its own systemd on its own kernel, which is an ordinary process: User Mode Linux.

Debian's package user-mode-linux. Unlike a container's, its kernel shares out processor time, memory and tasks whatever
this computer's kernel does, and has virtual CAN. It has one processor, which is slow at calling the kernel.
"""

import os
import subprocess
from pathlib import Path
from shutil import copytree, disk_usage

from tests.benches.preloads import preload

MEMORY_MB, SECOND_MB = 1536, 256
"""Sizes of the guest's memory, and of an empty second disk, /dev/ubdb."""
MODULES = Path("/usr/lib/uml/modules")
SHARED = Path("/dev/shm")
"""A file system in memory, where there is one."""
LONGEST_S = 1500.0
_WIDE_REGISTERS = Path(__file__).with_name("wide_registers.cc")
UNIT = """\
[Unit]
After=multi-user.target
[Service]
Type=exec
ExecStartPre=mount -t hostfs none /mnt -o {folder}
ExecStart={command}
ExecStopPost=systemctl poweroff
"""


class UserModeDebian:
    """A guest that boots, runs one command, and powers off.

    Parameters
    ----------
    root: a folder with a Debian that has systemd and kmod; the guest works on a copy of it, with this kernel's modules
    folder: of this computer; the guest has it as /mnt
    """

    def __init__(self, root: Path, folder: Path) -> None:
        self._root, self._folder = root, folder

    def run(self, command: str) -> None:
        """Boot, and run a command as root once everything has started.

        Raises RuntimeError: it did not power off in time, or could not boot; with the end of its console.
        """
        (modules,) = MODULES.iterdir()
        copytree(modules, self._root / "usr/lib/modules" / modules.name)
        units = self._root / "etc/systemd/system"
        (units / "tries.service").write_text(UNIT.format(folder=self._folder, command=command), encoding="utf-8")
        wants = units / "graphical.target.wants"
        wants.mkdir(exist_ok=True)
        (wants / "tries.service").symlink_to("/etc/systemd/system/tries.service")
        image, second, console = (self._folder / name for name in ("image", "second", "console"))
        made = ["mkfs.ext4", "-q", "-F", "-d", str(self._root), str(image), "4G"]
        subprocess.run(made, check=True, capture_output=True, timeout=LONGEST_S)
        second.touch()
        os.truncate(second, SECOND_MB * 2**20)
        kernel = [
            "linux.uml", f"ubd0={image}", f"ubd1={second}", "root=/dev/ubda", "rw", f"mem={MEMORY_MB}M",
            "con=null", "con0=null,fd:1", "ssl=null", "systemd.unified_cgroup_hierarchy=1", "quiet",
        ]  # fmt: skip
        with console.open("wb") as out:
            guest = subprocess.Popen(
                kernel, stdin=subprocess.DEVNULL, stdout=out, stderr=out, cwd=self._folder, start_new_session=True,
                env={
                    **os.environ,
                    "HOME": str(self._folder),
                    "TMPDIR": str(self._memory()),
                    "LD_PRELOAD": str(preload(_WIDE_REGISTERS)),
                },
            )  # fmt: skip
            try:
                status = guest.wait(LONGEST_S)
            except subprocess.TimeoutExpired:
                status = None
            finally:
                if guest.poll() is None:
                    os.killpg(guest.pid, 9)
                    guest.wait()
                image.unlink()
                second.unlink()
        if status != 0:
            told = console.read_text(encoding="utf-8", errors="replace")
            raise RuntimeError(
                f"{' '.join(kernel)}: {'not ended in time' if status is None else status}\n{told[-4000:]}"
            )

    def _memory(self) -> Path:
        """Where the file that is the guest's memory lies: on a disk, this computer writes it out again and again."""
        if not SHARED.is_dir() or os.statvfs(SHARED).f_flag & os.ST_NOEXEC:  # the guest maps its memory to run it
            return self._folder
        return SHARED if disk_usage(SHARED).free > 2 * MEMORY_MB * 2**20 else self._folder
