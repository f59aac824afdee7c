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


_UNITS = ((1.0, "s", 120), (60.0, "min", 120), (3600.0, "h", 48))
"""Size, name, and the number from which the next unit is used."""


def duration_text(seconds: float, *, tenths: bool = False) -> str:
    """`119 s`, `2 min`, `47 h`, `2 days`: in the largest unit of which there are two. tenths: of less than 10 s."""
    if tenths and seconds < 9.95:
        return f"{seconds:.1f} s"
    for size, unit, most in _UNITS:
        if (count := round(seconds / size)) < most:
            return f"{count} {unit}"
    return f"{seconds / 86400.0:.0f} days"


def terminal(*, stderr: bool = False) -> "Console":
    """A console that prints text as it is: names of files, channels and settings contain brackets and colons."""
    from rich.console import Console

    return Console(stderr=stderr, markup=False, emoji=False)
