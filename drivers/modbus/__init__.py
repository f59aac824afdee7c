"""Modbus RTU, also over TCP, and Modbus TCP."""
