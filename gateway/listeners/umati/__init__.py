"""OPC UA for Machine Tools (umati): a read-only server that shows what gateways publish.

`MachineToolServer` loads asyncua's server: import it where it is used.
"""
