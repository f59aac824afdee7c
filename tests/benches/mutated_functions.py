"""Differences of a mutant from its module: in functions, whose code can be exchanged, or outside of them."""

import ast
import gc
import inspect
import warnings
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import CodeType, FunctionType


@dataclass(frozen=True, slots=True)
class Mutant:
    """One change of a module; line counts from 1, `source` is the whole changed module."""

    operator: str
    occurrence: int
    line: int
    source: str


def is_another(before: str, after: str, enumerations: Collection[str] = ()) -> bool:
    """Whether a changed source is another program. It is not if it is invalid, or differs only in line numbers. Nor is
    it with `==` for `is` before a member of one of these enumerations, because a member is a single object."""
    try:
        if _meaning(_compiled(before)) == _meaning(_compiled(after)):
            return False
        return not (enumerations and _same_member(before, after, enumerations))
    except SyntaxError:
        return False


def _same_member(before: str, after: str, enumerations: Collection[str]) -> bool:
    same = {ast.Is: ast.Eq, ast.IsNot: ast.NotEq}
    olds, news = _comparisons(before), _comparisons(after)
    changes = [(old, new) for old, new in zip(olds, news, strict=False) if old[0] is not new[0]]
    if len(olds) != len(news) or len(changes) != 1:
        return False
    (old, *operands), (new, *_) = changes[0]
    return same.get(old) is new and any(
        isinstance(each, ast.Attribute) and ast.unparse(each.value) in enumerations for each in operands
    )


def _comparisons(source: str) -> list[tuple[type[ast.cmpop], ast.expr, ast.expr]]:
    """Operator, left and right, in the order of a walk."""
    return [
        (type(how), left, right)
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Compare)
        for how, left, right in zip(node.ops, [node.left, *node.comparators], node.comparators, strict=False)
    ]


def exchanges(before: str, after: str, file: Path) -> list[tuple[str, int, CodeType]] | None:
    """Qualified name, first line and new code of each function that differs; None: something else differs too."""
    outside, functions = _parts(_compiled(before, file))
    outside_after, functions_after = _parts(_compiled(after, file))
    if outside != outside_after or len(functions) != len(functions_after):
        return None
    return [
        (old.co_qualname, old.co_firstlineno, new)
        for old, new in zip(functions, functions_after, strict=True)
        if _meaning(old) != _meaning(new)
    ]


def loaded_functions(file: Path) -> Mapping[tuple[str, int], FunctionType]:
    """The functions of a loaded file by qualified name and first line; methods too, with decorators or without."""
    gc.unfreeze()  # what is frozen is not among the objects
    found = [each for each in gc.get_objects() if isinstance(each, FunctionType)]
    gc.freeze()
    codes = ((each, each.__code__) for each in found)
    return {(c.co_qualname, c.co_firstlineno): each for each, c in codes if c.co_filename == str(file)}


def statement_lines(source: str, line: int) -> range:
    """The lines of the innermost statement that a line belongs to; of a compound one, those of its head."""
    ranges = [each for each in _statements(ast.parse(source)) if line in each]
    return min(ranges, key=len, default=range(line, line + 1))


def _statements(tree: ast.AST) -> Iterator[range]:
    for node in ast.walk(tree):
        if isinstance(node, ast.match_case):
            yield range(node.pattern.lineno, max(node.pattern.lineno + 1, node.body[0].lineno))
        elif isinstance(node, ast.stmt | ast.ExceptHandler):
            body = getattr(node, "body", None) or getattr(node, "cases", None)
            first = body[0] if body else None
            inner = first.pattern.lineno if isinstance(first, ast.match_case) else getattr(first, "lineno", None)
            end = (node.end_lineno or node.lineno) + 1 if inner is None else max(inner, node.lineno + 1)
            yield range(node.lineno, end)


@lru_cache(maxsize=4)
def _compiled(source: str, file: Path | str = "") -> CodeType:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SyntaxWarning)  # as `is` with a number
        return compile(source, str(file), "exec", dont_inherit=True)


def _own(code: CodeType) -> tuple[object, ...]:
    return (
        code.co_name, code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags, code.co_code,
        code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars, code.co_exceptiontable,
    )  # fmt: skip


def _constant(value: object) -> object:
    """With its type: 1, 1.0 and True are equal, and 0.0 is -0.0."""
    if isinstance(value, tuple):
        return type(value), tuple(map(_constant, value))
    if isinstance(value, frozenset):
        return type(value), tuple(sorted(repr(_constant(each)) for each in value))
    return type(value), repr(value)


def _meaning(code: CodeType) -> tuple[object, ...]:
    constants = tuple(_meaning(each) if isinstance(each, CodeType) else _constant(each) for each in code.co_consts)
    return _own(code), constants


def _parts(code: CodeType) -> tuple[tuple[object, ...], list[CodeType]]:
    """The parts of a module or class: what is outside functions, and the functions, also those in classes."""
    outside: list[object] = [_own(code)]
    functions: list[CodeType] = []
    for each in code.co_consts:
        if not isinstance(each, CodeType):
            outside.append(_constant(each))
        elif each.co_name.startswith("<"):
            outside.append(_meaning(each))
        elif each.co_flags & inspect.CO_OPTIMIZED:
            outside.append(each.co_name)
            functions.append(each)
        else:
            inner, methods = _parts(each)
            outside.append(inner)
            functions += methods
    return tuple(outside), functions
