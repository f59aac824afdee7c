"""Versions of the packages that results depend on, to be stored with them."""

import platform
from importlib.metadata import version

_NUMERICS = ("talc-gateway", "numpy", "scipy", "osqp")


def versions(*more: str) -> str:
    """Versions of Python, of this program, of the numerics and of `more` distributions."""
    return ", ".join(
        [f"python {platform.python_version()}", *(f"{name} {version(name)}" for name in (*_NUMERICS, *more))]
    )
