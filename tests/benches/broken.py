"""Breaks one function of the loaded code for a while: a test of what it promises must then fail.

What is broken is named by identifiers within the function, not by its text or line.
"""

import ast
import inspect
import os
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from importlib import import_module
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any
from unittest.mock import patch

from tests.benches import linuxcnc_module
from tests.benches.linuxcnc_module import module_at

Break = Callable[[ast.AST], ast.AST]
"""Changes the definition of a function."""
VARIABLE = "TALC_GATEWAY_BROKEN"


def gives(value: str) -> Break:
    """It returns this expression and does nothing else."""
    return _body([ast.Return(ast.parse(value, mode="eval").body)])


def without(name: str) -> Break:
    """No statement that calls this, or assigns to it."""

    def change(node: ast.AST) -> ast.AST:
        match node:
            case ast.Assign(targets=[target]) if _named(target, name):
                return ast.Pass()
            case ast.Expr(ast.Call(func=func) | ast.Await(ast.Call(func=func))) if _named(func, name):
                return ast.Pass()
        return node

    return _each(change)


def instead(name: str, value: str) -> Break:
    """This expression in place of the name, or of a call of it."""

    def change(node: ast.AST) -> ast.AST:
        match node:
            case ast.Call(func=func) if _named(func, name):
                return ast.parse(value, mode="eval").body
            case ast.Name(ctx=ast.Load()) | ast.Attribute(ctx=ast.Load()) if _named(node, name):
                return ast.parse(value, mode="eval").body
        return node

    return _each(change)


def only_first(name: str) -> Break:
    """A call of this becomes its first argument."""

    def change(node: ast.AST) -> ast.AST:
        return node.args[0] if isinstance(node, ast.Call) and _named(node.func, name) else node

    return _each(change)


def always(name: str) -> Break:
    """The smallest conditions that mention this are true."""
    return _conditions(name, True)


def never(name: str) -> Break:
    """The smallest conditions that mention this are false."""
    return _conditions(name, False)


def uncaught(name: str) -> Break:
    """This exception is not caught."""

    def change(node: ast.AST) -> ast.AST:
        if isinstance(node, ast.ExceptHandler) and node.type is not None and _mentions(node.type, name):
            node.type = ast.Tuple([], ast.Load())
        return node

    return _each(change)


@contextmanager
def broken(function: str, how: Break) -> Iterator[None]:
    """Inside, `package.module:Class.function` is broken, also where it was imported before.

    `folder/file.py:Class.function`: in each module that tests.benches.linuxcnc_module loads from that file.
    """
    place, _, name = function.partition(":")
    if place.endswith(".py"):

        def load(path: Path) -> Any:
            module = module_at(path)
            if path.as_posix().endswith(place):
                _break(_function(module, name), name, how)
            return module

        with patch.object(linuxcnc_module, "module_at", load):
            yield
        return
    target = _function(import_module(place), name)
    original = target.__code__
    _break(target, name, how)
    try:
        yield
    finally:
        target.__code__ = original


def broken_by_environment() -> AbstractContextManager[None]:
    """In a process that a test starts: `function how name` of VARIABLE, if it is set."""
    if not (words := os.environ.get(VARIABLE, "").split()):
        return nullcontext()
    function, how, name = words
    return broken(function, {"only_first": only_first, "without": without}[how](name))


def _break(target: FunctionType, name: str, how: Break) -> None:
    target.__code__ = _changed(target, name, how)


def _changed(target: FunctionType, name: str, how: Break) -> CodeType:
    file = inspect.getsourcefile(target)
    assert file is not None
    tree = ast.parse(Path(file).read_text("utf-8"))
    node: Any = tree
    for part in name.split("."):
        (node,) = (n for n in node.body if getattr(n, "name", "") == part)
    before = ast.dump(node)
    how(node)
    assert ast.dump(node) != before, f"{name}: nothing to break"
    whole = compile(ast.fix_missing_locations(tree), file, "exec")
    codes = [code for code in _codes(whole) if code.co_qualname == name]
    assert len(codes) == 1, f"{name}: {len(codes)} functions"
    return codes[0]


def _codes(code: CodeType) -> Iterator[CodeType]:
    for each in code.co_consts:
        if isinstance(each, CodeType):
            yield each
            yield from _codes(each)


def _function(module: object, name: str) -> FunctionType:
    found: Any = module
    for part in name.split("."):
        found = inspect.getattr_static(found, part)
    found = inspect.unwrap(getattr(found, "fget", None) or getattr(found, "__func__", None) or found)
    assert isinstance(found, FunctionType)
    return found


def _body(body: list[ast.stmt]) -> Break:
    def change(node: ast.AST) -> ast.AST:
        assert isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        node.body = body
        return node

    return change


class _Each(ast.NodeTransformer):
    def __init__(self, change: Break) -> None:
        self._change = change

    def generic_visit(self, node: ast.AST) -> ast.AST:
        changed = self._change(node)
        return super().generic_visit(node) if changed is node else changed


def _each(change: Break) -> Break:
    return lambda node: _Each(change).visit(node)


def _conditions(name: str, value: bool) -> Break:
    def change(node: ast.AST) -> ast.AST:
        for field, old in ast.iter_fields(node):
            if isinstance(old, list):
                old[:] = [replaced(each, node) for each in old]
            else:
                setattr(node, field, replaced(old, node))
        return node

    def replaced(node: Any, parent: ast.AST) -> Any:
        if not isinstance(node, ast.AST) or not _mentions(node, name):
            return node
        before = ast.dump(node)
        change(node)
        return ast.Constant(value) if ast.dump(node) == before and _is_condition(node, parent) else node

    return change


def _is_condition(node: ast.AST, parent: ast.AST) -> bool:
    match parent:
        case ast.If(test=test) | ast.While(test=test) | ast.IfExp(test=test) if node is test:
            return True
        case ast.BoolOp() | ast.UnaryOp(op=ast.Not()) | ast.match_case(guard=ast.expr()):
            return isinstance(node, ast.expr)
    return isinstance(node, ast.Compare)


def _mentions(node: ast.AST, name: str) -> bool:
    return any(_named(each, name) for each in ast.walk(node))


def _named(node: ast.AST, name: str) -> bool:
    return (isinstance(node, ast.Name) and node.id == name) or (isinstance(node, ast.Attribute) and node.attr == name)
