"""The command line `talc-gateway`."""

from gateway.cli.condition import doctor, status
from gateway.cli.main import main
from gateway.cli.recorded import prior, replay, report
from gateway.cli.scan import scan

for command in (scan, status, doctor, replay, prior, report):
    main.add_command(command)

__all__ = ["main"]
