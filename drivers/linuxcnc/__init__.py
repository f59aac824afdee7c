"""LinuxCNC: settings of a control with the agent of deploy/nc/linuxcnc; drivers.agent communicates with it."""
