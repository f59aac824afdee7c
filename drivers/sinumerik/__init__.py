"""SINUMERIK controls over OPC UA.

`make_sinumerik` makes the driver itself: it loads OPC UA, which takes half a second and 20 MB.
"""

from drivers.sinumerik.make import make_sinumerik
from drivers.sinumerik.programs import ErrorTerms, errors_program
from drivers.sinumerik.settings import OffsetRoute, SinumerikControl, SinumerikSettings, StateNode, default_states

__all__ = [
    "ErrorTerms",
    "OffsetRoute",
    "SinumerikControl",
    "SinumerikSettings",
    "StateNode",
    "default_states",
    "errors_program",
    "make_sinumerik",
]
