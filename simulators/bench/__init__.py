"""An emulated machine with all its devices, and the configuration of its gateway: a program, not a library.

`python -m simulators.bench` runs it; nothing of it is imported.
"""

__all__: list[str] = []
