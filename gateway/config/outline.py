"""What a stored configuration says without its kinds: this program may refuse it, or lack the package of a kind.

`stored_configuration` reads the whole. These read a few fields of the same text, and agree with it wherever it can.
"""

import json
from collections.abc import Mapping
from typing import Any, Final

_FIRST_METHOD: Final = "models"
_STEP_S: Final = 300.0
"""Step of programs that did not store it."""


def of_any_program(data: Mapping[str, Any]) -> Mapping[str, Any]:
    """The data of a stored text. All defaults are written out in it: one without a method is from a program that had
    only the models."""
    talc = data.get("talc", {})
    return {**data, "talc": {"method": _FIRST_METHOD, **talc}} if data and isinstance(talc, Mapping) else data


def outlined(config: str) -> Mapping[str, Any]:
    """The data in a stored text; empty if the text is none."""
    try:
        whole = json.loads(config)
    except ValueError:
        return {}
    return of_any_program(whole) if isinstance(whole, dict) else {}


def step_s_of(config: str) -> float:
    """The grid step."""
    return float(outlined(config).get("grid", {}).get("step_s", _STEP_S))


def inputs_of_config(config: str) -> tuple[str, ...]:
    """Names of the inputs. Raises ValueError for a text that is not one of this gateway."""
    return _inputs_in(json.loads(config))


def inputs_if_known(config: str) -> tuple[str, ...]:
    """Likewise; none of a text that is not one of this gateway."""
    return _inputs_in(outlined(config))


def _inputs_in(data: Mapping[str, Any]) -> tuple[str, ...]:
    channels = (name for device in data.get("device", ()) for name in device["channels"])
    return (*channels, *(state["name"] for state in data.get("state", ())))
