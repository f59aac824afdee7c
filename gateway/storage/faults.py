"""Errors that the store raises."""


class StoreError(Exception):
    """The database cannot be used; the message says which file, why and what to do."""


class DamagedError(StoreError):
    """What the file holds is damaged."""


class GoneError(StoreError):
    """The database is no longer at its path."""
