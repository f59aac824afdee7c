"""Work in a process of its own: its answer, a clear message on failure, and no process left behind."""

import asyncio
import os
import pickle
import resource
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from gateway.runtime.workers.process import WorkError, in_process
from tests.benches.endless_work import say, work_endlessly
from tests.benches.processes import children, is_alive
from tests.benches.waits import until

GATEWAY = """
import asyncio, sys
from pathlib import Path
from gateway.runtime.workers.process import in_process
from tests.benches.endless_work import work_endlessly
asyncio.run(in_process(work_endlessly, Path(sys.argv[1])))
"""
JOINING = """
import sys
import gateway.runtime.workers.__main__ as program
from tests.benches.endless_work import say
program.join_learning = lambda: say("joined")
sys.exit(program.main())
"""


async def test_it_works_at_a_lower_priority_than_the_gateway() -> None:
    own = os.getpriority(os.PRIO_PROCESS, 0)
    assert await in_process(os.getpriority, os.PRIO_PROCESS, 0) == min(own + 10, 19)
    assert children(os.getpid()) == []


def test_it_joins_the_control_group_of_what_learns_before_it_works() -> None:
    program = subprocess.Popen([sys.executable, "-c", JOINING], stdin=subprocess.PIPE, stderr=subprocess.PIPE)
    with program:  # the end of its input would end the work
        assert program.stdin is not None
        assert program.stderr is not None
        program.stdin.write(pickle.dumps((say, ("works",), {}, 0.0, 0)))
        program.stdin.flush()
        assert program.stderr.read().decode() == "joined\nworks\n"
    assert program.returncode == 0


async def test_what_the_work_raises_is_reported() -> None:
    with pytest.raises(WorkError, match=r"ZeroDivisionError: .* \(exit status 1\)"):
        await in_process(divmod, 1, 0)


async def test_killed_work_is_reported(tmp_path: Path) -> None:
    working = asyncio.create_task(in_process(work_endlessly, tmp_path / "begun"))
    await until((tmp_path / "begun").exists)
    os.kill(children(os.getpid())[0], signal.SIGKILL)
    with pytest.raises(WorkError, match="SIGKILL; out of memory"):
        await working


async def test_work_beyond_its_limit_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gateway.runtime.workers.process.WORK_LIMIT_S", 0.05)
    with pytest.raises(WorkError, match="did not finish"):
        await in_process(work_endlessly, tmp_path / "begun")
    assert children(os.getpid()) == []


async def test_a_computer_without_descriptors_is_reported() -> None:
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    spare = os.open(os.devnull, os.O_RDONLY)
    os.close(spare)
    resource.setrlimit(resource.RLIMIT_NOFILE, (spare, limits[1]))
    try:
        with pytest.raises(WorkError, match=r"no process could be started: Too many open files$"):
            await in_process(os.getpid)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)
    assert children(os.getpid()) == []


async def test_cancelling_ends_the_process(tmp_path: Path) -> None:
    working = asyncio.create_task(in_process(work_endlessly, tmp_path / "begun"))
    await until((tmp_path / "begun").exists)
    working.cancel()
    with pytest.raises(asyncio.CancelledError):
        await working
    assert children(os.getpid()) == []


async def test_work_ends_when_the_gateway_is_killed(tmp_path: Path) -> None:
    begun, working = tmp_path / "begun", list[int]()
    gateway = await asyncio.create_subprocess_exec(sys.executable, "-c", GATEWAY, str(begun))
    try:
        await until(begun.exists)
        working += children(gateway.pid)
        assert len(working) == 1
        gateway.kill()
        await until(lambda: not is_alive(working[0]))
    finally:
        for pid in (gateway.pid, *working):
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        await gateway.wait()
