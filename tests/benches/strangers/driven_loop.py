"""An event loop whose clock advances only when nothing is left to do, with TCP connections inside the process."""

import asyncio
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from datetime import UTC, datetime, timedelta
from typing import Any, Protocol

_BEGIN_S = 1000.0
_BEGIN_UTC = datetime(2026, 1, 1, tzinfo=UTC)
_MOST_TURNS = 3_000_000
"""More turns of the loop mean that something asks without waiting."""


class Host(Protocol):
    """What listens at an address."""

    def connected(self, line: "Line") -> None: ...

    def heard(self, line: "Line", data: bytes) -> None: ...

    def left(self, line: "Line") -> None: ...

    @property
    def refuses(self) -> bool:
        """Whether a connection is refused just now."""
        ...


class DrivenLoop(asyncio.BaseEventLoop):
    """Waits cost nothing: time jumps to the next deadline. It has no sockets and no threads."""

    def __init__(self) -> None:
        super().__init__()
        self._now_s, self._turns = _BEGIN_S, 0
        self._clock_resolution = 1e-9
        self._selector = self
        self.hosts: dict[str, Host] = {}
        self.before_time_passes: Callable[[], None] = lambda: None
        self.is_cut = False
        """Whether no host can be reached, as for a program that has been killed."""
        self._lines: list[Line] = []

    def time(self) -> float:
        return self._now_s

    def select(self, timeout: float | None) -> list[Any]:
        """Called by asyncio when it would wait."""
        self._turns += 1
        if timeout is None or self._turns > _MOST_TURNS:
            raise RuntimeError("nothing will ever happen" if timeout is None else "something asks without waiting")
        if timeout > 0:
            self.before_time_passes()
        self._now_s += timeout
        return []

    def _process_events(self, event_list: list[Any]) -> None:
        """There are none."""

    def _write_to_self(self) -> None:
        """No other thread wakes it."""

    def cut(self) -> None:
        """End all connections, and let no new one come about."""
        self.is_cut = True
        for line in self._lines:
            line.hang_up()

    def run_in_executor(  # type: ignore[override]
        self, _: Any, work: Callable[..., Any], *given: Any
    ) -> asyncio.Future[Any]:
        """Work for a thread is done at once, and takes no time."""
        done = self.create_future()
        try:
            done.set_result(work(*given))
        except Exception as error:  # noqa: BLE001 - raised where it is waited for
            done.set_exception(error)
        return done

    async def create_connection(self, factory: Callable[[], Any], host: str, _: int, **__: Any) -> Any:  # type: ignore[override]
        """Connect to one of the hosts. Raises ConnectionRefusedError."""
        await asyncio.sleep(0.001)
        served = self.hosts[host]
        if served.refuses or self.is_cut:
            raise ConnectionRefusedError(111, "Connection refused")
        line = Line(self, factory(), served)
        self._lines = [*(one for one in self._lines if one.is_open), line]
        line.protocol.connection_made(line)
        served.connected(line)
        return line, line.protocol


class _Socket:
    def setsockopt(self, *_: object) -> None:
        """Nothing to set."""


class Line(asyncio.Transport):
    """A connection: the client's transport, and the server's way to answer."""

    def __init__(self, loop: DrivenLoop, protocol: Any, host: Host) -> None:
        super().__init__()
        self._loop, self.protocol, self._host = loop, protocol, host
        self.is_open = True
        self.opened_s = loop.time()

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        return _Socket() if name == "socket" else default

    def write(self, data: bytes | bytearray | memoryview) -> None:
        if self.is_open:
            self._loop.call_soon(self._host.heard, self, bytes(data))

    def abort(self) -> None:
        self.close()

    def close(self) -> None:
        """The client leaves."""
        if self.is_open:
            self.is_open = False
            self._host.left(self)
            self._loop.call_soon(self.protocol.connection_lost, None)

    def is_closing(self) -> bool:
        return not self.is_open

    def send(self, data: bytes, at_s: float) -> None:
        """The server's bytes arrive at that time, unless the connection is closed by then."""
        self._loop.call_at(at_s, self._arrive, data)

    def _arrive(self, data: bytes) -> None:
        if self.is_open:
            self.protocol.data_received(data)

    def hang_up(self) -> None:
        """The server closes it."""
        if self.is_open:
            self.is_open = False
            self._host.left(self)
            self._loop.call_soon(self.protocol.connection_lost, None)


class LoopClock:
    """The loop's time as the clock of a service."""

    def __init__(self, loop: DrivenLoop) -> None:
        self._loop = loop

    def monotonic(self) -> float:
        return self._loop.time()

    def utc(self) -> datetime:
        return _BEGIN_UTC + timedelta(seconds=self._loop.time() - _BEGIN_S)

    async def sleep_until(self, monotonic_s: float) -> None:
        await asyncio.sleep(max(0.0, monotonic_s - self._loop.time()))

    def hold(self) -> AbstractContextManager[None]:
        return nullcontext()

    def synchronised(self) -> bool:
        return True

    def origin(self) -> str:
        return "driven"


def run_driven(main: Callable[[DrivenLoop], Any]) -> Any:
    """As asyncio.run, on a driven loop, which `main` is given. Raises the first error of a callback, such as a host's
    too."""
    loop, errors = DrivenLoop(), list[BaseException]()

    def keep(_: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        if "handle" in context:
            errors.append(context["exception"])

    with asyncio.Runner(loop_factory=lambda: loop) as runner:
        loop.set_exception_handler(keep)
        result = runner.run(main(loop))
    if errors:
        raise errors[0]
    return result
