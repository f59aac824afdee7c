"""The consoles that commands print to."""

from rich.console import Console


def terminal(*, stderr: bool = False) -> Console:
    """What is printed there stands as it is: names of files, channels and settings hold brackets and colons."""
    return Console(stderr=stderr, markup=False, emoji=False)
