"""The consoles that commands print to, and the forms of what they print."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console


def printable(text: str) -> str:
    """The text with \ufffd for every character that a terminal would obey or not show, such as escape and line end."""
    return text if text.isprintable() else "".join(c if c.isprintable() else "\ufffd" for c in text)


def counted(count: int, one: str, several: str = "") -> str:
    """`1 bus`, `2 buses`. several: the plural, if it is not `one` with an s."""
    return f"{count} {one if count == 1 else several or one + 's'}"


def terminal(*, stderr: bool = False) -> "Console":
    """A console that prints text as it is: names of files, channels and settings contain brackets and colons."""
    from rich.console import Console

    return Console(stderr=stderr, markup=False, emoji=False)
