"""Before a gateway runs: devices are found, and an agent is tried against its contract."""
