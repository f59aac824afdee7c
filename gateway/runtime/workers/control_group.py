"""A control group (cgroup) for the processes that learn, of a lower weight than the gateway's own.

systemd gives the service its control group to divide (`Delegate=cpu` in the unit file). The gateway makes two groups
below it: one for itself and one for the processes that learn. All of these together then get a tenth of the
gateway's processor time while both want it, however many processes and threads they are; with their niceness alone
(gateway.runtime.workers.__main__), every further thread takes another tenth. The files are those of the kernel's
Documentation/admin-guide/cgroup-v2.rst.
"""

import os
from contextlib import suppress
from pathlib import Path

_GATEWAY = "gateway"
"""Name of the gateway's own group, below the service's."""
_LEARNING = "learning"
"""Name of the group that learns."""
WEIGHT = 10
"""Weight of the group `learning`; the gateway's is the kernel's default, 100."""

_GROUPS = Path("/sys/fs/cgroup")
_OWN = Path("/proc/self/cgroup")
_DELEGATED = "user.delegate"
"""The attribute by which systemd marks a group that it has handed over (systemd.resource-control(5))."""


class UndividedError(Exception):
    """The service's group was handed over, but could not be divided; the message says why."""


def divide(groups: Path = _GROUPS, own: Path = _OWN) -> bool:
    """Make both groups, and move this process into its own; False: no group was handed to this process.

    groups: where the control groups are mounted
    own: the kernel's list of the groups that this process is in

    Raises UndividedError: the learning processes then have only their lower priority.
    """
    group = _group(groups, own)
    if group is None or not _handed_over(group):
        return False
    try:
        if "cpu" not in (group / "cgroup.controllers").read_text(encoding="ascii").split():
            raise UndividedError(f"{group}: this kernel or its manager shares out no processor time there")
        for name in (_GATEWAY, _LEARNING):
            (group / name).mkdir(exist_ok=True)
        # A group whose controllers are in use below it may hold no processes itself, so the gateway leaves it first.
        (group / _GATEWAY / "cgroup.procs").write_text(str(os.getpid()), encoding="ascii")
        (group / "cgroup.subtree_control").write_text("+cpu", encoding="ascii")
        (group / _LEARNING / "cpu.weight").write_text(str(WEIGHT), encoding="ascii")
    except OSError as error:
        raise UndividedError(f"{error.filename or group}: {error.strerror}") from error
    return True


def join_learning(groups: Path = _GROUPS, own: Path = _OWN) -> None:
    """Move this process from the gateway's group into the group of the learning processes, if `divide` made them."""
    group = _group(groups, own)
    if group is not None and group.name == _GATEWAY and (group.parent / _LEARNING).is_dir():
        with suppress(OSError):  # it has its lower priority in any case
            (group.parent / _LEARNING / "cgroup.procs").write_text(str(os.getpid()), encoding="ascii")


def _group(groups: Path, own: Path) -> Path | None:
    """The group of this process in the unified hierarchy; None: it has none, or all that is mounted."""
    try:
        lines = own.read_text(encoding="utf-8").splitlines()
    except OSError:
        return None
    for line in lines:
        path = line.removeprefix("0::/")
        if path not in (line, ""):
            return groups / path
    return None


def _handed_over(group: Path) -> bool:
    try:
        return os.getxattr(group, _DELEGATED) == b"1"
    except OSError:
        return False
