"""The other side of every wire: plant physics, device emulators, an emulated numerical control.

Other packages use the packages named here, and the clock. None is imported: LinuxCNC's own Python reads this file too.
"""

__all__ = ["bench", "cases", "clock", "devices", "linuxcnc", "nc", "plant", "three_body"]
