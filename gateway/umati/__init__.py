"""OPC UA for Machine Tools (umati): a read-only server that shows what gateways publish.

`MachineToolServer` loads asyncua's server: import it where it is used.
"""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from gateway.umati.server import MachineToolServer
    from gateway.umati.settings import ShownMachine, check_serving, load_serving
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".server": ("MachineToolServer",),
            ".settings": ("ShownMachine", "check_serving", "load_serving"),
        },
    )

__all__ = [
    "MachineToolServer",
    "ShownMachine",
    "check_serving",
    "load_serving",
]
