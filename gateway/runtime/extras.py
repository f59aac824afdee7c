"""Optional dependencies: a command that needs one says what to install, and how here."""

import os
import shlex
import sys
from importlib.metadata import requires
from importlib.util import find_spec
from pathlib import Path
from typing import Final, Literal

import click

from gateway.model.codes import NoticeCode
from gateway.model.text import Text, language_wanted

Extra = Literal["parquet", "postgres", "report", "web"]
_PACKAGES = {
    "parquet": ("pyarrow",),
    "postgres": ("psycopg", "pyarrow"),
    "report": ("jinja2", "matplotlib"),
    "web": ("starlette", "uvicorn", "jinja2"),
}
_DEBIAN: Final = Path("/opt/talc-gateway")
"""Where Debian's package has its environment, with `web`; another package adds `report` to it."""


def need_extra(extra: Extra) -> None:
    """Raises click.UsageError where packages of an extra are not installed, in the terminal's language."""
    if lack := lack_of(extra):
        raise click.UsageError(lack.in_language(language_wanted(os.environ)))


def lack_of(extra: Extra) -> Text | None:
    """What is not installed, and what installs it on this computer; None: nothing is missing."""
    missing = [name for name in _PACKAGES[extra] if find_spec(name) is None]
    if not missing:
        return None
    if extra == "report" and Path(sys.prefix) == _DEBIAN:
        return Text(NoticeCode.REPORT_NOT_INSTALLED, missing=missing)
    return Text(NoticeCode.EXTRA_NOT_INSTALLED, missing=missing, command=_command(extra))


def _command(extra: Extra) -> str:
    """Installs what the extra requires into this environment, which need not have a pip of its own."""
    own = find_spec("pip") is not None
    pip = [sys.executable, "-m", "pip"] if own else ["python3", "-m", "pip", "--python", sys.executable]
    lines = [line.partition(";") for line in requires("talc-gateway") or ()]
    wanted = [what.strip() for what, _, when in lines if extra in shlex.split(when)]
    return shlex.join([*pip, "install", *wanted])
