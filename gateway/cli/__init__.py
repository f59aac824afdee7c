"""The command line `talc-gateway`."""

from gateway.cli.condition import doctor, status
from gateway.cli.inspection import inspect
from gateway.cli.inspection_named import nodes_command, objects_command
from gateway.cli.inspection_topics import topics_command
from gateway.cli.main import main
from gateway.cli.recorded import prior, replay, report
from gateway.cli.scan import scan

for named in (objects_command, nodes_command, topics_command):
    inspect.add_command(named)
for command in (scan, inspect, status, doctor, replay, prior, report):
    main.add_command(command)

__all__ = ["main"]
