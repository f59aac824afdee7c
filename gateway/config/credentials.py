"""Files that hold a secret, and when a certificate is reported as ending soon."""

import stat
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path
from typing import Final

from drivers.agent import AgentAddress
from drivers.bus_settings import is_loopback

ENDS_SOON: Final = timedelta(days=30)
"""A certificate that ends within this time is reported."""


def secret_cautions(path: Path) -> Iterator[str]:
    """Why this file with a secret is not as it should be."""
    try:
        mode = path.stat().st_mode
    except OSError as error:
        yield f"'{path}' cannot be read: {error.strerror}"
    else:
        if mode & (stat.S_IRGRP | stat.S_IROTH):
            yield f"'{path}' can be read by other users; chmod 600"


def agent_cautions(agent: AgentAddress) -> Iterator[tuple[str, str]]:
    """Field of the connection to an agent, and why it is less safe than it could be. Reads files."""
    if not is_loopback(agent.host):
        yield "host", f"'{agent.host}' is another computer: use a tunnel, lines are signed but not encrypted"
    yield from (("key_file", text) for text in secret_cautions(agent.key_file))
