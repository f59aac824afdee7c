"""The page's program beside a gateway that this process plays, and the memory that the program takes."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.benches.free_port import free_port
from tests.benches.page_rig import PageRig
from tests.benches.played_telemetry import PlayedGateway
from tests.benches.zenoh_sessions import listening


@contextmanager
def played_page(rig: PageRig) -> Iterator[tuple[PlayedGateway, int]]:
    """The gateway of the machine `mill`, which has published nothing yet, and the number of the page's process."""
    port = free_port()
    with listening(port) as session, tempfile.TemporaryDirectory() as folder:
        gateway = PlayedGateway(session, "mill", "boot-1")
        settings = Path(folder) / "web.toml"
        settings.write_text("[machine.mill]\ntolerance_um = 8.0\n", encoding="utf-8")
        rig.serve([port], settings)
        if rig.web is None:
            raise RuntimeError("the page's program has not started")
        yield gateway, rig.web.pid


def resident_mb(pid: int) -> float:
    """Memory of a process, with the files that it maps."""
    status = Path(f"/proc/{pid}/status").read_text(encoding="ascii")
    return int(status.partition("VmRSS:")[2].split()[0]) / 1024.0
