"""Before a gateway runs: find devices and read them by hand, write its first configuration, prepare the control.

The commands `scan`, `inspect`, `init`, `probe`, `nc` and `agent-test`. Others use the modules named here; none is
imported.
"""
