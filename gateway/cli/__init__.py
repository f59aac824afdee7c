"""The command line `talc-gateway`."""

from gateway.cli.main import main

__all__ = ["main"]
