"""The agent of examples/agent within the test's process, and machines for it."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from drivers.agent.settings import AgentSettings
from tests.benches.linuxcnc_module import module_at
from tests.benches.stream_server import stream_server

FILE = Path(__file__).parents[2] / "examples" / "agent" / "agent.py"
REFERENCE = module_at(FILE)
KEY = b"0123456789abcdef0123456789abcdef"
POSES_DEG = tuple((float(a), float(c)) for a, c in REFERENCE.POSES)


@dataclass
class ServedAgent:
    """An agent that listens."""

    machine: Any
    port: int

    def key_file(self, folder: Path) -> Path:
        file = folder / "agent.key"
        file.write_bytes(KEY + b"\n")
        file.chmod(0o600)
        return file

    def settings(self, folder: Path, timeout_s: float = 2.0) -> AgentSettings:
        """The settings of a gateway with its key."""
        key_file = self.key_file(folder)
        return AgentSettings(key_file=key_file, port=self.port, timeout_s=timeout_s, poses_deg=POSES_DEG)


@asynccontextmanager
async def served_agent(machine: Any, module: Any = REFERENCE) -> AsyncIterator[ServedAgent]:
    """A served agent. module: the agent's, or a spoilt one."""
    it = module.Agent(KEY, machine)

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            await it.serve(reader, writer)
        except Exception as error:
            if module is REFERENCE:
                raise
            print("the spoilt agent:", repr(error))

    async def tick() -> None:
        while True:
            machine.tick()
            await asyncio.sleep(REFERENCE.TICK_S)

    async with stream_server(serve, limit=module.LONGEST_LINE) as port:
        ticking = asyncio.create_task(tick())
        try:
            yield ServedAgent(machine, port)
        finally:
            ticking.cancel()
            await asyncio.gather(ticking, return_exceptions=True)


def spoilt_reference(*changes: tuple[str, str]) -> Any:
    """The module with these pieces of its text replaced, each of which occurs in it."""
    text = FILE.read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    module = ModuleType("spoilt_reference")
    exec(compile(text, str(FILE), "exec"), module.__dict__)
    return module


def workshop_machine() -> Any:
    """A machine with an operator: it works, stops, and reaches a safe point on request."""

    class WorkshopMachine(REFERENCE.Machine):  # type: ignore[misc,name-defined]
        state: str
        reason: str

        def __init__(self) -> None:
            super().__init__()
            self.told, self.safe = super().status({}), False

        def stop(self) -> None:
            self.told["estop"] = True

        def status(self, it: object) -> dict[str, Any]:
            return {**self.told, "probing": super().status(it)["probing"]}

        def tick(self) -> None:
            if self.told["estop"] and self.state in REFERENCE.NEXT:
                self.state = "refused" if self.state == "requested" else "failed"
                self.reason = "an emergency stop"
            if self.state == "requested" and not self.safe:
                return
            super().tick()

    return WorkshopMachine()
