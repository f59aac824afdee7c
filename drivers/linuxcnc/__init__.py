"""LinuxCNC through its agent."""
