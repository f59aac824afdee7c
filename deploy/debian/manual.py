"""Writes the manual page and the shells' completion below a folder: python manual.py VERSION FOLDER."""

import gzip
import sys
from collections.abc import Iterator
from pathlib import Path

import click
from click.shell_completion import get_completion_class

from gateway.cli.main import main

PROGRAM = "talc-gateway"
COMPLETIONS = {
    "bash": f"bash-completion/completions/{PROGRAM}",
    "zsh": f"zsh/vendor-completions/_{PROGRAM}",
    "fish": f"fish/vendor_completions.d/{PROGRAM}.fish",
}


def helps(command: click.Command, name: str, parent: click.Context | None) -> Iterator[tuple[str, str]]:
    """Name and help of a command and of those in it."""
    context = click.Context(command, info_name=name, parent=parent, max_content_width=78, terminal_width=78)
    yield context.command_path, command.get_help(context)
    for inner in command.list_commands(context) if isinstance(command, click.Group) else ():
        found = command.get_command(context, inner)  # type: ignore[attr-defined]
        if found is not None:
            yield from helps(found, inner, context)


def manual(version: str) -> str:
    """The page, in troff."""
    parts = [
        f'.TH TALC-GATEWAY 1 "" "{PROGRAM} {version}"',
        f".SH NAME\n{PROGRAM} \\- thermal adaptive learning control for five-axis machine tools",
        ".SH FILES\n.I /etc/talc-gateway/gateway.toml\n.br\n.I /usr/share/doc/talc-gateway/docs",
        "(the pages that messages name; examples are beside them)",
    ]
    for name, text in helps(main, PROGRAM, None):
        escaped = text.replace("\\", "\\e").replace("-", "\\-").replace("\n.", "\n\\&.").replace("\n'", "\n\\&'")
        parts.append(f'.SH "{name.upper()}"\n.nf\n{escaped}\n.fi')
    return "\n".join(parts) + "\n"


def write(version: str, folder: Path) -> None:
    page = folder / "man/man1" / f"{PROGRAM}.1.gz"
    page.parent.mkdir(parents=True, exist_ok=True)
    page.write_bytes(gzip.compress(manual(version).encode(), mtime=0))
    for shell, name in COMPLETIONS.items():
        kind = get_completion_class(shell)
        if kind is None:
            raise ValueError(f"click completes nothing for {shell}")
        made = kind(main, {}, PROGRAM, f"_{PROGRAM}_COMPLETE".replace("-", "_").upper())
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(made.source_template % made.source_vars(), encoding="utf-8")


if __name__ == "__main__":
    write(sys.argv[1], Path(sys.argv[2]))
