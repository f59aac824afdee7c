"""The gateway as a process: `run` and `record`, what starts, what it tells systemd, a configuration that is read again.

Others use the modules named here. None is imported.
"""
