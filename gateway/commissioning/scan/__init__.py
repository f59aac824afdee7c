"""Finds the devices on a wire, or looks into one, to write a configuration. It only reads."""
