"""Finds private names of one source file that another one uses, where Ruff (SLF001) does not look."""

import ast
import inspect
import re
import textwrap
from collections.abc import Iterator
from functools import cache
from importlib import import_module

_PRIVATE = re.compile(r"_(?!_)\w*(?<!_)")
"""`_field_` with an underscore at its end is a documented name of enum and ctypes."""

_OWN = ("self", "cls", "super()")


def private_of_others(source: str) -> list[str]:
    """Its imports of a private module or name; in its classes, the private names that it has of a base class of another
    module, used or overridden; and the objects that it makes objects of another class."""
    nodes = list(ast.walk(ast.parse(source)))
    found = [name for node in nodes for name in _imported(node)]
    found += [
        f"{ast.unparse(node)} ="
        for node in nodes
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store) and node.attr == "__class__"
    ]
    classes = {node.name: node for node in nodes if isinstance(node, ast.ClassDef)}
    places = dict(place for node in nodes for place in _places(node))
    for node in classes.values():
        own, outer = _family(node, classes)
        of_file = {name for one in own for name in _defined(one)}
        found += [f"{node.name}: {name} is not defined here" for name in sorted(_used(node) - of_file)]
        if defined := _defined(node):  # only then a base must be loaded
            of_others = {name for base in outer for name in _of_base(base, places)}
            found += [f"{node.name}: {name} overrides another's" for name in sorted(defined & of_others)]
    return found


def _imported(node: ast.AST) -> Iterator[str]:
    if isinstance(node, ast.ImportFrom):
        names = [f"{node.module or ''}.{alias.name}" for alias in node.names]
    else:
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
    yield from (name for name in names if any(map(_PRIVATE.fullmatch, name.split("."))))


def _places(node: ast.AST) -> Iterator[tuple[str, tuple[str, ...]]]:
    """For each imported name its module, and the name there if it is not a module itself."""
    if isinstance(node, ast.ImportFrom):
        yield from ((alias.asname or alias.name, (str(node.module), alias.name)) for alias in node.names)
    elif isinstance(node, ast.Import):
        firsts = ((alias, alias.name.split(".")[0]) for alias in node.names)
        yield from ((alias.asname or first, (alias.name if alias.asname else first,)) for alias, first in firsts)


def _family(node: ast.ClassDef, classes: dict[str, ast.ClassDef]) -> tuple[list[ast.ClassDef], list[str]]:
    """The class with its bases in the file, and the names of those from elsewhere, without their parameters."""
    own, outer = [node], list[str]()
    for one in own:
        for base in one.bases:
            name = ast.unparse(base.value if isinstance(base, ast.Subscript) else base)
            if name not in classes:
                outer.append(name)
            elif classes[name] not in own:
                own.append(classes[name])
    return own, outer


def _defined(node: ast.ClassDef) -> set[str]:
    """Private names of the class body, and those that its methods set."""
    names = [one.attr for one in _attributes(node) if isinstance(one.ctx, ast.Store)]
    for one in node.body:
        match one:
            case ast.FunctionDef() | ast.AsyncFunctionDef() | ast.ClassDef():
                names.append(one.name)
            case ast.Assign() | ast.AnnAssign():
                targets = one.targets if isinstance(one, ast.Assign) else [one.target]
                names += [part.id for target in targets for part in ast.walk(target) if isinstance(part, ast.Name)]
    return {name for name in names if _PRIVATE.fullmatch(name)}


def _used(node: ast.ClassDef) -> set[str]:
    return {one.attr for one in _attributes(node)}


def _attributes(node: ast.AST) -> Iterator[ast.Attribute]:
    """Private attributes of self, cls and super() in a class, without those of a class within it."""
    for child in ast.iter_child_nodes(node):
        match child:
            case ast.ClassDef():
                continue
            case ast.Attribute(value, name) if _PRIVATE.fullmatch(name) and ast.unparse(value) in _OWN:
                yield child
        yield from _attributes(child)


def _of_base(name: str, places: dict[str, tuple[str, ...]]) -> set[str]:
    """Private names of a class that is imported; of a builtin one none."""
    first, _, rest = name.partition(".")
    if first not in places:
        return set()
    module, *path = places[first]
    found: object = import_module(module)
    for part in [*path, *filter(None, rest.split("."))]:
        found = getattr(found, part) if hasattr(found, part) else import_module(f"{module}.{part}")
    return {own for one in found.__mro__ for own in _of_class(one)} if isinstance(found, type) else set()


@cache
def _of_class(found: type) -> frozenset[str]:
    names = {name for name in vars(found) if _PRIVATE.fullmatch(name)}
    try:
        (node,) = ast.parse(textwrap.dedent(inspect.getsource(found))).body
    except (OSError, TypeError):  # compiled, or made by a call
        return frozenset(names)
    return frozenset(names | _defined(node)) if isinstance(node, ast.ClassDef) else frozenset(names)
