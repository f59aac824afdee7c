"""The consoles that commands print to."""

from rich.console import Console


def terminal(*, stderr: bool = False) -> Console:
    """A console that prints text as it is: names of files, channels and settings contain brackets and colons."""
    return Console(stderr=stderr, markup=False, emoji=False)
