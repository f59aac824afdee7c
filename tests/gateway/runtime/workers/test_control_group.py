"""The control group of what learns, in a folder that represents the kernel's files."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from gateway.runtime.workers.control_group import UndividedError, divide, join_learning

SERVICE = "system.slice/talc-gateway.service"
OwnList = Callable[[str], Path]


@pytest.fixture
def group(tmp_path: Path) -> Path:
    """The service's group, handed over by systemd, as the kernel shows it."""
    made = tmp_path / SERVICE
    made.mkdir(parents=True)
    (made / "cgroup.controllers").write_text("cpu memory pids\n")
    os.setxattr(made, "user.delegate", b"1")
    return made


@pytest.fixture
def within(tmp_path: Path) -> OwnList:
    """The kernel's list of the groups of a process that is in this one."""

    def listed(name: str) -> Path:
        own = tmp_path / "own"
        own.write_text(f"9:name=systemd:/\n0::/{name}\n")
        return own

    return listed


def test_the_gateway_makes_two_groups_and_goes_into_its_own(group: Path, within: OwnList, tmp_path: Path) -> None:
    assert divide(tmp_path, within(SERVICE))
    assert (group / "gateway" / "cgroup.procs").read_text() == str(os.getpid())
    assert (group / "cgroup.subtree_control").read_text() == "+cpu"
    assert (group / "learning" / "cpu.weight").read_text() == "10"
    assert divide(tmp_path, within(SERVICE)), "started again in the same group"


def test_what_learns_leaves_the_gateways_group(group: Path, within: OwnList, tmp_path: Path) -> None:
    divide(tmp_path, within(SERVICE))
    join_learning(tmp_path, within(f"{SERVICE}/gateway"))
    assert (group / "learning" / "cgroup.procs").read_text() == str(os.getpid())


def test_nothing_is_divided_that_was_not_handed_over(group: Path, within: OwnList, tmp_path: Path) -> None:
    """For example a user's session, which root could change as well."""
    os.removexattr(group, "user.delegate")
    assert not divide(tmp_path, within(SERVICE))
    assert not divide(tmp_path, within(""))
    assert not divide(tmp_path, tmp_path / "no such list")
    assert not (group / "gateway").exists()


def test_what_learns_stays_where_there_are_no_groups(group: Path, within: OwnList, tmp_path: Path) -> None:
    (group / "gateway").mkdir()
    join_learning(tmp_path, within(f"{SERVICE}/gateway"))
    join_learning(tmp_path, within(SERVICE))
    assert not (group / "learning").exists()


def test_a_kernel_without_shares_of_the_processor_is_named(group: Path, within: OwnList, tmp_path: Path) -> None:
    (group / "cgroup.controllers").write_text("hugetlb\n")
    with pytest.raises(UndividedError, match=r"talc-gateway\.service"):
        divide(tmp_path, within(SERVICE))


def test_a_refusal_is_named(group: Path, within: OwnList, tmp_path: Path) -> None:
    (group / "cgroup.subtree_control").mkdir()  # as little a file to write as one that is read-only
    with pytest.raises(UndividedError, match=r"cgroup\.subtree_control"):
        divide(tmp_path, within(SERVICE))
