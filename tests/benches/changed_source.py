"""Changes the source of loaded modules for a while, to plant defects and see that a bench finds them."""

import inspect
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

from tests.benches.mutated_functions import exchanges


@dataclass(frozen=True, slots=True)
class SourceChange:
    """A change within a function of a module. The new text imports itself what it needs and the module lacks."""

    module: ModuleType
    text: str
    """Occurs exactly once in the module."""
    instead: str


@contextmanager
def changed(changes: Sequence[SourceChange]) -> Iterator[None]:
    """Inside, the functions do what their changed source says, also where they were imported before."""
    sources = dict[ModuleType, str]()
    for change in changes:
        source = sources.get(change.module) or _file(change.module).read_text(encoding="utf-8")
        count = source.count(change.text)
        assert count == 1, f"{change.module.__name__}: {change.text!r} occurs {count} times, expected once"
        sources[change.module] = source.replace(change.text, change.instead)
    with ExitStack() as stack:
        for module, source in sources.items():
            file = _file(module)
            differing = exchanges(file.read_text(encoding="utf-8"), source, file)
            assert differing, f"{module.__name__}: no function differs, or something else does"
            for name, _, code in differing:
                function = _function(module, name)
                stack.callback(setattr, function, "__code__", function.__code__)
                function.__code__ = code
        yield


def _file(module: ModuleType) -> Path:
    assert module.__file__ is not None
    return Path(module.__file__)


def _function(module: ModuleType, name: str) -> FunctionType:
    """The function of this qualified name; the one inside a property or decorator."""
    found: Any = module
    for part in name.split("."):
        found = inspect.getattr_static(found, part)
    if isinstance(found, property):
        found = found.fget
    found = inspect.unwrap(found)
    assert isinstance(found, FunctionType), f"{module.__name__}: {name} cannot be found"
    assert found.__code__.co_qualname == name, f"{module.__name__}: {name} is {found.__code__.co_qualname}"
    return found
