"""The database of a gateway: writing while it runs, and reading."""
