"""Libraries for LD_PRELOAD, compiled when they are needed."""

import hashlib
import os
import subprocess
import tempfile
from functools import cache
from pathlib import Path


@cache
def preload(source: Path) -> Path:
    """A library, compiled once for each user and version of the source. Raises subprocess.CalledProcessError."""
    mark = hashlib.sha256(source.read_bytes()).hexdigest()[:16]
    path = Path(tempfile.gettempdir()) / f"talc-gateway-{source.stem.replace('_', '-')}-{os.getuid()}-{mark}.so"
    if not path.exists():
        with tempfile.TemporaryDirectory() as folder:
            made = Path(folder) / path.name
            compiler = ["g++", "-std=c++17", "-O1", "-shared", "-fPIC", "-Wall", "-Wextra", "-Werror"]
            subprocess.run([*compiler, "-o", made, source, "-ldl"], check=True)
            made.replace(path)  # in one step, because other workers may look
    return path
