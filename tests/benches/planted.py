"""Defects that are put into the gateway, to see that a bench finds them."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from unittest.mock import patch

Defect = Sequence[tuple[object, str, object]]
"""Whose attribute is replaced, which one, by what; in a module also the name of a builtin."""


@contextmanager
def planted(defect: Defect) -> Iterator[None]:
    """Inside, gateways have this defect."""
    with ExitStack() as stack:
        for target, attribute, instead in defect:
            stack.enter_context(patch.object(target, attribute, instead, create=True))
        yield
