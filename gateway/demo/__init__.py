"""Emulated machines and devices, for a gateway on the same computer: `demo` and `play`.

Only these commands use the simulators. Others use the modules named here; none is imported.
"""
