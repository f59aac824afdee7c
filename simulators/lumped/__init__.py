"""The physics of a five-axis machine: heat, temperatures, elastic consequences. Knows no protocol and no clock."""

from simulators.lumped.machine import MachinePlant

__all__ = ["MachinePlant"]
