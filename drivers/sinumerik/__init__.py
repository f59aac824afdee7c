"""SINUMERIK controls over OPC UA.

The driver itself is made by `make_sinumerik`: it loads OPC UA, half a second and 20 MB.
"""

from drivers.sinumerik.make import make_sinumerik
from drivers.sinumerik.settings import SinumerikControl, SinumerikSettings, StateNode, default_states

__all__ = ["SinumerikControl", "SinumerikSettings", "StateNode", "default_states", "make_sinumerik"]
