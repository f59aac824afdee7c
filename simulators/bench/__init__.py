"""An emulated machine with all its devices, which `python -m simulators.bench` runs, and its gateway's configuration.

Others import only the text of the configuration.
"""

from collections.abc import Mapping
from importlib.resources import files

__all__ = ["gateway_toml"]


def gateway_toml(places: Mapping[str, object]) -> str:
    """The gateway's configuration, with these values for the names that stand in braces in gateway.toml."""
    text = files("simulators.bench").joinpath("gateway.toml").read_text(encoding="utf-8")
    for name, value in places.items():
        text = text.replace("{" + name + "}", str(value))
    return text
