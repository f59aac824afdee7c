"""Chooses how a site is kept by what is given for it: a folder, or the address of a database."""

from pathlib import Path
from typing import TYPE_CHECKING

from gateway.listeners.collect.folder import SiteFolder

if TYPE_CHECKING:
    from gateway.listeners.collect.database import SiteDatabase


def site_at(where: str, password_file: Path | None = None) -> "SiteFolder | SiteDatabase":
    """To be entered. A database needs psycopg.

    Raises ValueError for an address that is invalid or holds a password.
    """
    if "://" not in where:
        return SiteFolder(Path(where))
    from gateway.listeners.collect.database import SiteDatabase

    return SiteDatabase(where, password_file)
