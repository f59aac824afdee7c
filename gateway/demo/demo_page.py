"""The demo's page: `talc-gateway web` for its machine, in a separate process that ends when the demo does."""

import asyncio
import os
import signal
import sys
import threading
from asyncio.subprocess import Process
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

from gateway.model.text import Language
from gateway.runtime.extras import lack_of

PAGE_LOG = "page.log"
"""In the demo's folder: what the page's program says. A terminal that shows the run has no place for it."""
_SETTINGS = "web.toml"
_READY_LIMIT_S = 60.0
_END_LIMIT_S = 10.0
_NICE = 10
"""The run comes first: a page that is a second late does not make its gateway wait."""


class DemoPage:
    """The process that serves the page, which begins beside the machine."""

    def __init__(self, process: Process, log: Path) -> None:
        self._process, self._log = process, log

    async def line(self, language: Language) -> str:
        """Its address, in words; or why there is none, which does not stop the demo."""
        if self._process.stdout is None:
            raise RuntimeError("the page's process has no pipe")
        try:
            said = await asyncio.wait_for(self._process.stdout.readline(), _READY_LIMIT_S)
        except TimeoutError:
            said = b""
        address = said.decode().strip()
        return language("demo.page_at" if address else "demo.page_failed", address=address, log=str(self._log))


@asynccontextmanager
async def demo_page(folder: Path, zenoh_port: int, machine_use: str) -> AsyncIterator[DemoPage | None]:
    """While it is entered, the page is served at a free port of 127.0.0.1; None: its packages are not installed.

    machine_use: the settings of the page, TOML
    """
    if lack_of("web"):
        yield None
        return
    settings, log = folder / _SETTINGS, folder / PAGE_LOG
    settings.write_text(machine_use, encoding="utf-8")
    with log.open("wb") as errors:
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "gateway.demo.demo_page", f"tcp/127.0.0.1:{zenoh_port}", str(settings)),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=errors,
            start_new_session=True,  # Ctrl-C is for the gateway
        )
    try:
        yield DemoPage(process, log)
    finally:
        if process.stdin is not None:
            process.stdin.close()
        try:
            await asyncio.wait_for(process.wait(), _END_LIMIT_S)
        except TimeoutError:
            process.kill()
            await process.wait()


def _end_with_input() -> None:
    """The demo's end closes the pipe, also when it is killed."""
    os.read(sys.stdin.fileno(), 1)
    os.kill(os.getpid(), signal.SIGTERM)


def _serve(endpoint: str, settings: str) -> None:
    from gateway.listeners.web.serve import WebCommand, serve_pages  # not in the demo's own process

    os.nice(_NICE)
    threading.Thread(target=_end_with_input, daemon=True).start()
    serve_pages(WebCommand(None, (endpoint,), None, Path(settings), "127.0.0.1", 0))


if __name__ == "__main__":
    _serve(sys.argv[1], sys.argv[2])
