"""Devices that nobody here wrote: drawn from seeds, played on a driven clock, read by the gateway and a plain client.

Nothing here uses the drivers' code.
"""
