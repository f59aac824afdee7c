"""The real LinuxCNC with the files of deploy/nc/linuxcnc, headless, in namespaces of its own.

Its own IPC namespace because there is one LinuxCNC in each; its own process and network namespaces because its stop
script kills by name and its server takes a fixed port.
"""

import asyncio
import json
import os
import shutil
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

FILES = Path(__file__).parents[2] / "deploy" / "nc" / "linuxcnc"
PEER = Path(__file__).parent / "peers" / "linuxcnc"

_NAMESPACES = ("--ipc", "--pid", "--mount", "--net", "--fork", "--mount-proc", "--kill-child")
_START = 'ip link set lo up 2>/dev/null; mount --bind "$1" /tmp && cd /tmp/nc && exec linuxcnc -r /tmp/nc/talc.ini'
_REAL_TIME_USER = 65534
"""LinuxCNC's real-time part refuses root unless it is told which user it works for: nobody."""
_BOOT_S, _ANSWER_S, _STOP_S = 60.0, 60.0, 30.0


class Machine:
    """What the operator can do at the control."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self.process = process

    async def ask(self, verb: str, *arguments: str) -> Any:
        """Raises RuntimeError with what the control said."""
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps([verb, *arguments]).encode() + b"\n")
        answer = await self.line(_ANSWER_S)
        if "error" in answer:
            raise RuntimeError(f"{verb} {arguments}: {answer['error']}")
        return answer["answer"]

    async def number(self, kind: str, name: str) -> float:
        """A HAL pin (getp) or signal (gets)."""
        return float(await self.ask("hal", kind, name))

    async def line(self, timeout_s: float) -> dict[str, Any]:
        """The operator's next line; LinuxCNC's own talk is passed over and shown when it ends."""
        assert self.process.stdout is not None
        said = []
        async with asyncio.timeout(timeout_s):
            while line := await self.process.stdout.readline():
                if line.startswith(b"{"):
                    answer: dict[str, Any] = json.loads(line)
                    return answer
                said.append(line.decode(errors="replace"))
        raise RuntimeError(f"LinuxCNC has ended:\n{''.join(said)}")


@asynccontextmanager
async def machine(folder: Path) -> AsyncIterator[Machine]:
    """LinuxCNC from ready until it has shut itself down. folder: an empty one; becomes its /tmp."""
    assert shutil.which("linuxcnc") is not None, "LinuxCNC is missing: install Debian's linuxcnc-uspace"
    assert os.geteuid() == 0, "namespaces of its own need root: run this test as root"
    os.chown(folder, _REAL_TIME_USER, -1)
    shutil.copytree(FILES, folder / "nc")
    screen = folder / "nc" / "screen.py"
    shutil.copy(PEER / "screen.py", screen)
    ini = folder / "nc" / "talc.ini"
    ini.write_text(ini.read_text().replace("DISPLAY = dummy", "DISPLAY = /tmp/nc/screen.py"))
    screen.chmod(0o755)
    process = await asyncio.create_subprocess_exec(
        "unshare",
        *_NAMESPACES,
        *("sh", "-c", _START, "sh", str(folder)),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.STDOUT,
        env={"PATH": os.environ["PATH"], "HOME": "/tmp", "RTAPI_UID": str(_REAL_TIME_USER)},
    )
    assert process.stdin is not None
    try:
        it = Machine(process)
        await it.line(_BOOT_S)
        yield it
    finally:
        process.stdin.close()
        try:
            async with asyncio.timeout(_STOP_S):
                await process.communicate()
        except TimeoutError:
            process.kill()  # this process alone: the kernel ends its namespace with it
            await process.wait()
