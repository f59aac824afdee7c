"""The real LinuxCNC, headless, in namespaces of its own, with a virtual sphere that the emulated machine moves."""
