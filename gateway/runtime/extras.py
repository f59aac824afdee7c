"""Optional dependencies: a command that needs one says what to install."""

from importlib.util import find_spec
from typing import Literal

import click

Extra = Literal["parquet", "postgres", "report", "web"]
_PACKAGES = {
    "parquet": ("pyarrow",),
    "postgres": ("psycopg", "pyarrow"),
    "report": ("jinja2", "matplotlib"),
    "web": ("starlette", "uvicorn", "jinja2"),
}


def need_extra(extra: Extra) -> None:
    """Raises click.UsageError where packages of an extra are not installed. Debian's package has `web`, and another one
    `report`."""
    if missing := missing_of(extra):
        debian = "install the package talc-gateway-report, or " if extra == "report" else ""
        raise click.UsageError(f"{', '.join(missing)} not installed; {debian}pip install 'talc-gateway[{extra}]'")


def missing_of(extra: Extra) -> list[str]:
    """Packages of an extra that are not installed."""
    return [name for name in _PACKAGES[extra] if find_spec(name) is None]
