"""Errors that the store raises."""


class StoreError(Exception):
    """The database cannot be used; the message says which file, why and what to do."""


class DamagedError(StoreError):
    """The contents of the file are damaged."""


class GoneError(StoreError):
    """The database is no longer at its path."""
