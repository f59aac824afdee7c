"""The real LinuxCNC, headless, in its own namespaces, with a virtual sphere that the emulated machine moves.

Others use the module named here. It is not imported: LinuxCNC's own Python reads this file too.
"""

__all__ = ["machine"]
