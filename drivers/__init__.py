"""Drivers, which read one device or control each. They do not know TALC or the gateway.

They have no schedule: the gateway decides when a device is read, and when one that failed is read again.

Each folder is a family. Settings, profiles and `family` load no library of a protocol; the buses, devices and controls
do, so import those where they are needed.
"""
