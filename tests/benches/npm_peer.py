"""Third-party programs that run on Node.js, for the tests with marker `peer`.

Needs Debian's nodejs and npm; the first run fetches the locked packages into the peer's own node_modules.
"""

import asyncio
import os
import shutil
import subprocess
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from fcntl import LOCK_EX, flock
from pathlib import Path

PEERS = Path(__file__).parent / "peers"


def node_with(peer: str, package: str) -> str:
    """The Node.js program, with that peer's packages in place."""
    program, npm = shutil.which("node"), shutil.which("npm")
    assert program is not None, "Node.js is missing: install Debian's nodejs and npm"
    assert npm is not None, "npm is missing: install Debian's npm"
    folder = PEERS / peer
    with (folder / "package.json").open() as file:
        flock(file, LOCK_EX)  # other workers of the same run look, too
        if not (folder / "node_modules" / package).is_dir():
            command = [npm, "ci", "--ignore-scripts", "--no-audit", "--no-fund"]
            done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=600, check=False)
            assert done.returncode == 0, f"npm ci failed: {done.stderr[-2000:]}"
    return program


@asynccontextmanager
async def running(
    node: str, script: str, *arguments: Path | int | str, slow: bool = False
) -> AsyncIterator[tuple[str, asyncio.subprocess.Process]]:
    """A peer's program; it runs from the line that says where it listens until its standard input ends."""
    process = await asyncio.create_subprocess_exec(
        node,
        str(PEERS / script),
        *map(str, arguments),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.DEVNULL,
        env=os.environ | ({"SLOW": "1"} if slow else {}),
    )
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        async with asyncio.timeout(300.0):
            while b"listening on" not in (line := await process.stdout.readline()):
                assert line, "the peer ended without listening"
        yield line.decode().split()[-1], process
    finally:
        process.stdin.close()
        try:
            await asyncio.wait_for(process.wait(), 5.0)
        except TimeoutError:
            process.kill()
            await process.wait()
