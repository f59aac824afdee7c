"""Files that hold a secret."""

import stat
from collections.abc import Iterator
from pathlib import Path


def secret_cautions(path: Path) -> Iterator[str]:
    """Why this file with a secret is not as it should be."""
    try:
        mode = path.stat().st_mode
    except OSError as error:
        yield f"'{path}' cannot be read: {error.strerror}"
    else:
        if mode & (stat.S_IRGRP | stat.S_IROTH):
            yield f"'{path}' can be read by other users; chmod 600"
