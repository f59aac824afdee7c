"""A hook of MkDocs: a page of every command and option, made from the commands themselves."""

import inspect
import re
from collections.abc import Iterator
from textwrap import fill

import click
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

from gateway.cli.main import main

_HEAD = """\
# Every command

What `--help` says of each command of `talc-gateway`. Exit codes: 0 success; 1 a check failed, or a fault of its own;
2 the configuration or the command line is invalid; 3 a fault outside the program.
"""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """The site's files, with `command-line.md`."""
    files.append(File.generated(config, "command-line.md", content=command_line_page()))
    return files


def command_line_page() -> str:
    """The page's text: a section for each command that is not hidden, with its arguments and options."""
    return "\n".join([_HEAD, *(text for path, command in _commands("", main) for text in _section(path, command))])


def _commands(path: str, command: click.Command) -> Iterator[tuple[str, click.Command]]:
    if path:
        yield path, command
    if isinstance(command, click.Group):
        context = click.Context(command)
        for name in command.list_commands(context):
            below = command.get_command(context, name)
            if below is not None and not below.hidden:
                yield from _commands(f"{path} {name}".strip(), below)


def _section(path: str, command: click.Command) -> Iterator[str]:
    context = click.Context(command, info_name=path)
    yield f"## {path}\n"
    yield f"`{' '.join([path, *command.collect_usage_pieces(context)])}`\n"
    for paragraph in re.split(r"\n\s*\n", inspect.cleandoc(command.help or "").replace("\b\n", "")):
        yield fill(_linked(paragraph), 120, break_long_words=False, break_on_hyphens=False) + "\n"
    records = [record for p in command.params if (record := p.get_help_record(context)) and record[1]]
    if records:
        yield "| option | meaning |\n|---|---|"
        for name, meaning in records:
            yield f"| `{_cell(name)}` | {_linked(_cell(meaning))} |"
        yield ""


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def _linked(text: str) -> str:
    """Pages of docs/ become links."""
    return re.sub(r"docs/([\w-]+\.md)", r"[docs/\1](\1)", text)
