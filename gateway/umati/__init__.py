"""OPC UA for Machine Tools (umati): a read-only server that shows what gateways publish.

`MachineToolServer` loads asyncua's server: import it where it is used.
"""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from gateway.umati.server import MachineToolServer
    from gateway.umati.settings import OpcUaServing, ServerSecurity, ShownMachine, check_serving, load_serving
    from gateway.umati.values import NodeShown, shown_now
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".server": ("MachineToolServer",),
            ".settings": ("OpcUaServing", "ServerSecurity", "ShownMachine", "check_serving", "load_serving"),
            ".values": ("NodeShown", "shown_now"),
        },
    )

__all__ = [
    "MachineToolServer",
    "NodeShown",
    "OpcUaServing",
    "ServerSecurity",
    "ShownMachine",
    "check_serving",
    "load_serving",
    "shown_now",
]
