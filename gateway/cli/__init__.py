"""The command line `talc-gateway`."""

from gateway.cli.main import main
from gateway.cli.scan import scan

main.add_command(scan)

__all__ = ["main"]
