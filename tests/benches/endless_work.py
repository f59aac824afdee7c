"""Work for a process apart that never ends by itself: only what is tested can end it."""

import signal
import sys
from pathlib import Path


def work_endlessly(begun: Path) -> None:
    """Notes in a file that it has begun."""
    begun.touch()
    while True:
        signal.pause()


def say(text: str) -> None:
    """On standard error, at once."""
    print(text, file=sys.stderr, flush=True)
