"""The telemetry of a gateway that takes commands and that a command can pause, with neither machine nor store.

`python -m tests.benches.commanded_gateway PORT MACHINE OPERATOR KEY_FILE` says `listening`, then each command.
"""

import asyncio
import sys
from pathlib import Path

from drivers.base import SystemClock
from gateway.config.telemetry import Operator, Telemetry
from gateway.model.commands import Command, CommandName, CommandOutcome, Pause
from gateway.model.control_state import NcState
from gateway.model.events import EventReported, Health, HealthChecked, StoreHealth
from gateway.model.text import plain
from gateway.telemetry.answers import CoursePage
from gateway.telemetry.messages import PublishedCourse
from talc.frame import Event, EventKind
from talc.names import THERMAL_ERRORS
from tests.benches.open_publisher import OpenPublisher

_STATUS_S = 5.0


async def main(port: int, machine: str, operator: str, key_file: Path) -> None:
    """Run until standard input ends."""
    clock, paused = SystemClock(), None
    may = (CommandName.PAUSE, CommandName.RESUME)
    settings = Telemetry(
        listen=(f"tcp/127.0.0.1:{port}",), operator=(Operator(name=operator, key_file=key_file, may=may),)
    )
    nothing = {error: PublishedCourse([], []) for error in THERMAL_ERRORS}
    stored = CoursePage([], nothing, [], nothing)

    def tell() -> None:
        publisher.publish(HealthChecked(Health(1.0, 0, 0, NcState.READY, True, (), StoreHealth(), paused)))

    async def obey(command: Command, refused: str) -> CommandOutcome:
        nonlocal paused
        if not refused:
            paused = Pause(command.by, clock.utc()) if command.name is CommandName.PAUSE else None
        print(command.by, command.name.value, refused, flush=True)
        publisher.publish(EventReported(Event(EventKind.COMMAND, f"{command.by}: {command.name.value}"), None))
        tell()
        return CommandOutcome(command, clock.utc(), not refused, plain(refused or "it is done"))

    async with OpenPublisher(
        settings, machine, (), clock, "boot", simulated=False, course=lambda _: stored, obey=obey
    ) as publisher:

        async def keep_telling() -> None:
            while True:
                tell()
                await asyncio.sleep(_STATUS_S)

        tell()
        print("listening", flush=True)
        telling = asyncio.create_task(keep_telling())
        await asyncio.to_thread(sys.stdin.readline)
        telling.cancel()


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1]), sys.argv[2], sys.argv[3], Path(sys.argv[4])))
