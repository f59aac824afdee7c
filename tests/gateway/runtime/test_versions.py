"""Versions that are stored with results."""

import platform
from importlib.metadata import version

from gateway.runtime.versions import versions


def test_the_numerics_and_what_is_asked_for_are_named_with_their_versions() -> None:
    found = dict(text.split(" ") for text in versions("asyncua").split(", "))
    assert found["python"] == platform.python_version()
    assert {"talc-gateway", "scipy", "osqp"} < set(found)
    assert (found["numpy"], found["asyncua"]) == (version("numpy"), version("asyncua"))
