"""Adds the control `ads` to talc-gateway: a Beckhoff TwinCAT PLC, which is only read."""
