"""Runs a command on Debian's real-time kernel (PREEMPT_RT), in an emulated computer.

`python -m tests.benches.real_time_kernel COMMAND...` runs it in this folder. The emulated computer has the files of
this one; what the command writes is lost afterwards. QEMU counts one nanosecond for each instruction that its only
processor executes; while it waits, its time passes as this computer's does. So how long something takes in it does not
depend on how fast or how busy this computer is. It has no caches: a time is a number of instructions, those of the
kernel's interruptions included. For x86-64; needs Debian's qemu-system-x86, busybox-static, kmod and cpio, and
downloads the kernel on first use.
"""

import os
import shlex
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).parents[2]
KERNEL = ROOT / "out" / "real-time-kernel"
LIMIT_S = 1800.0
"""Generous: a run of 30 s takes two minutes."""
_PACKAGE = "linux-image-rt-amd64"
_MODULES = "virtio_pci", "9pnet_virtio", "9p", "overlay"
_SHELL = "/bin/busybox"
_INIT = """#!/bin/busybox sh
alias mount='busybox mount'
mount -t proc proc /proc && mount -t sysfs sys /sys && mount -t devtmpfs dev /dev
for module in {modules}; do busybox insmod /$module; done
mount -t 9p -o trans=virtio,version=9p2000.L,msize=512000,cache=loose,ro host /host
mount -t tmpfs -o size=75% tmpfs /changes
busybox mkdir /changes/files /changes/work
mount -t overlay -o lowerdir=/host,upperdir=/changes/files,workdir=/changes/work overlay /root
for folder in proc sys dev; do mount --move /$folder /root/$folder; done
for folder in run dev/shm; do busybox mkdir -p /root/$folder && mount -t tmpfs tmpfs /root/$folder; done
busybox mkdir -p /root/dev/pts && mount -t devpts devpts /root/dev/pts
busybox ip link set lo up
busybox cp /command /root/run
exec busybox switch_root /root /usr/bin/env -i HOME=/root PATH=/usr/sbin:/usr/bin:/sbin:/bin \\
    PYTHONDONTWRITEBYTECODE=1 \\
    /bin/sh -c '(sh /run/command; echo "exit code $?") >/dev/ttyS1 2>&1; echo o >/proc/sysrq-trigger; sleep 60'
"""


def on_real_time_kernel(command: str, folder: Path) -> str:
    """The output of a shell command there. folder: for the emulated computer's own files.

    Raises RuntimeError if it fails, and subprocess.TimeoutExpired.
    """
    kernel, modules = _kernel()
    archive, said, console = folder / "initramfs", folder / "said", folder / "console"
    _make_archive(archive, folder / "files", modules, f"cd {shlex.quote(str(ROOT))} && {command}")
    emulator = [
        "qemu-system-x86_64", "-machine", "q35", "-accel", "tcg,thread=single", "-cpu", "max", "-smp", "1",
        "-icount", "shift=0,sleep=on", "-m", "2G", "-display", "none", "-nodefaults", "-no-reboot",
        "-kernel", str(kernel), "-initrd", str(archive), "-append", "console=ttyS0 quiet panic=-1",
        "-fsdev", "local,id=host,path=/,security_model=none,readonly=on,multidevs=remap",
        "-device", "virtio-9p-pci,fsdev=host,mount_tag=host",
        "-serial", f"file:{console}", "-serial", f"file:{said}",
    ]  # fmt: skip
    subprocess.run(emulator, check=True, timeout=LIMIT_S, stdin=subprocess.DEVNULL)
    text, _, code = said.read_text("utf-8", "replace").replace("\r\n", "\n").rpartition("exit code ")
    if code.strip() != "0":
        raise RuntimeError(f"{command}: exit code {code.strip()}\n{text}{console.read_text('utf-8', 'replace')}")
    return text


def _kernel() -> tuple[Path, list[Path]]:
    """The kernel, and its modules in the order in which they are loaded."""
    if not KERNEL.exists():
        KERNEL.parent.mkdir(exist_ok=True)
        with TemporaryDirectory(dir=KERNEL.parent) as scratch:
            _download(Path(scratch), Path(scratch) / "whole")
    (kernel,), (version,) = KERNEL.glob("boot/vmlinuz-*"), (KERNEL / "lib" / "modules").iterdir()
    shown = "modprobe", "--dirname", ".", "--set-version", version.name, "--show-depends"
    lines = [line.split()[1] for name in _MODULES for line in _said(KERNEL, *shown, name).splitlines()]
    return kernel, [KERNEL / line for line in dict.fromkeys(lines)]


def _download(scratch: Path, folder: Path) -> None:
    depends = _said(scratch, "apt-cache", "depends", "--important", _PACKAGE)
    if "Depends:" not in depends:
        raise RuntimeError(f"apt knows no {_PACKAGE}: run apt-get update")
    package = depends.split("Depends:")[1].split()[0]
    _said(scratch, "apt-get", "download", package)
    _said(scratch, "dpkg-deb", "--extract", *(str(each) for each in scratch.glob("*.deb")), str(folder))
    _said(folder, "depmod", "--basedir", ".", next((folder / "lib" / "modules").iterdir()).name)
    folder.rename(KERNEL)


def _said(where: Path, *command: str) -> str:
    environment = {**os.environ, "PATH": f"{os.environ['PATH']}:/usr/sbin:/sbin"}
    done = subprocess.run(command, cwd=where, env=environment, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{shlex.join(command)}: {done.stderr}")
    return done.stdout


def _make_archive(archive: Path, files: Path, modules: list[Path], command: str) -> None:
    for name in ("proc", "sys", "dev", "host", "changes", "root", "bin"):
        (files / name).mkdir(parents=True)
    for each in modules:
        (files / each.name).write_bytes(each.read_bytes())
    shell = files / "bin" / "busybox"
    shell.write_bytes(Path(_SHELL).read_bytes())
    init = files / "init"
    init.write_text(_INIT.format(modules=" ".join(each.name for each in modules)), "utf-8")
    (files / "command").write_text(command, "utf-8")
    for program in (shell, init):
        program.chmod(0o755)
    names = "\n".join(str(each.relative_to(files)) for each in sorted(files.rglob("*")))
    packed = subprocess.run(
        ["cpio", "-o", "-H", "newc", "--quiet"], cwd=files, input=names.encode(), check=True, capture_output=True
    )
    archive.write_bytes(packed.stdout)


if __name__ == "__main__":
    with TemporaryDirectory() as scratch:
        print(on_real_time_kernel(shlex.join(sys.argv[1:]), Path(scratch)), end="")
