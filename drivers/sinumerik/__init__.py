"""SINUMERIK controls over OPC UA.

`make_sinumerik` makes the driver itself: it loads OPC UA, which takes half a second and 20 MB.
"""

from typing import TYPE_CHECKING

from drivers.first_use import on_first_use

if TYPE_CHECKING:
    from drivers.sinumerik.make import make_sinumerik
    from drivers.sinumerik.programs import ErrorTerms, errors_program
    from drivers.sinumerik.settings import OffsetRoute, SinumerikControl, SinumerikSettings, StateNode, default_states
else:
    __getattr__ = on_first_use(
        __name__,
        {
            ".make": ("make_sinumerik",),
            ".programs": ("ErrorTerms", "errors_program"),
            ".settings": ("OffsetRoute", "SinumerikControl", "SinumerikSettings", "StateNode", "default_states"),
        },
    )

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
