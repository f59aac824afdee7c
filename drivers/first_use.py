"""Rooms that import their modules when a name of theirs is first used.

A program then loads only the libraries of the families that it uses: the page of a machine loads no Modbus, and a
gateway with serial devices loads no CAN.
"""

import sys
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module


def on_first_use(room: str, modules: Mapping[str, Sequence[str]]) -> Callable[[str], object]:
    """The `__getattr__` of a room (PEP 562), for names that are imported when they are first asked for.

    room: the package, its `__name__`
    modules: each module, relative to the room (`.bus`) or absolute, with the names that the room has from it; no name:
        the room has the module itself

    The returned function raises AttributeError for other names, as Python expects of it.
    """
    homes = {name: module for module, names in modules.items() for name in names}
    whole = {module.rpartition(".")[2]: module for module, names in modules.items() if not names}

    def load(name: str) -> object:
        if name in whole:
            return import_module(whole[name], room)  # which sets the attribute itself
        if name not in homes:
            raise AttributeError(f"module {room!r} has no attribute {name!r}")
        found: object = getattr(import_module(homes[name], room), name)
        setattr(sys.modules[room], name, found)  # not asked again
        return found

    return load
