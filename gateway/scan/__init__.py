"""Finds the devices on a wire, to write a configuration. It only reads."""
