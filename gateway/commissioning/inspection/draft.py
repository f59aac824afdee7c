"""The draft of a profile: how a person reads what was read, and the file that it goes to."""

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import click

from drivers.base import SetupError
from drivers.profiles import load_profile
from gateway.config.wires import toml_value


@dataclass(frozen=True, slots=True)
class Draft:
    """What is wanted. Raises click.UsageError if no draft can be written to this file."""

    file: Path | None
    """None: no draft is wanted."""
    scale: float
    """Value = number · scale."""
    quantity: str
    """Unit of the values."""

    def __post_init__(self) -> None:
        if self.file is not None and (self.file.exists() or self.file.suffix != ".toml"):
            wrong = "already exists, and a draft replaces nothing" if self.file.exists() else "does not end in .toml"
            raise click.UsageError(f"--draft: {self.file} {wrong}; give another name")


def now_text() -> str:
    """The time, for a draft."""
    return f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"


def write_draft(path: Path, text: str, unit: int) -> None:
    """Write a profile and say how to use it. Raises SetupError, and leaves no file, if the text is not a profile."""
    path.write_text(text, encoding="utf-8")
    try:
        profile = load_profile(str(path))
    except SetupError:
        path.unlink()
        raise
    click.echo(f"{path} written: {profile.channels} channels. Compare and change what says CONFIRM; then, for a bus:")
    click.echo(
        f'[[device]]\nname = "new"\nbus = "..."\nprofile = {toml_value(str(path))}\nunit = {unit}\n[device.channels]'
    )
    click.echo("\n".join(f"new_in{number} = {number}" for number in range(profile.channels)))
