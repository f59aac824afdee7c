"""An emulated machine with all its devices, and the configuration of its gateway."""
