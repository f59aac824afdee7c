"""Which methods run: METHODS of the environment names them, the user's own classes among them."""

import importlib
from collections.abc import Sequence

import numpy as np

from benchmarks.recordings.causal import Peeked, check_asked, check_causal, trial
from benchmarks.recordings.learner import Learning
from benchmarks.recordings.methods import HoldLast, Method, Nothing
from benchmarks.recordings.models import papers
from benchmarks.recordings.peers import peers
from benchmarks.recordings.policy import Deciding
from benchmarks.recordings.regressions import ridges
from benchmarks.recordings.series import Series

_BESIDE = ("none", "hold", "learner")
"""What the user's classes are compared with, if nothing else is named."""
_TRIED_UM = 2.5


def methods(series: Series, wanted: str = "") -> list[Method]:
    """All methods; or those named, and classes as `module:Class`, separated by commas. SystemExit: one is unknown, or
    a class does not fit, or knows a measurement before it was made."""
    gaps = bool(np.diff(series.k).max() > 1)
    known: list[Method] = [Nothing(), HoldLast(), *ridges(), *peers(), *papers(gaps=gaps), Learning()]
    names = [name.strip() for name in wanted.split(",") if name.strip()]
    if not names:
        return known
    own, shipped = [n for n in names if ":" in n], [n for n in names if ":" not in n]
    words = [_word(method) for method in known]
    for name in shipped:
        if name not in words:
            available = ", ".join(dict.fromkeys(words))
            raise SystemExit(f"METHODS: no method {name!r}; available: {available}, and your own as module:Class")
    chosen: Sequence[str] = shipped or _BESIDE
    return [*(m for m, word in zip(known, words, strict=True) if word in chosen), *(_own(name) for name in own)]


def _word(method: Method) -> str:
    """`search` of "`search`, gaps cut out"."""
    return method.name.split(",")[0].strip("`").replace(" ", "-")


def _own(name: str) -> Method:
    """The method of a class that is made without arguments, after the checks on a made-up day."""
    module, _, attribute = name.partition(":")
    try:
        method: Method = getattr(importlib.import_module(module), attribute)()
    except (ImportError, AttributeError, TypeError) as error:
        raise SystemExit(f"METHODS: {name!r} cannot be made: {error}; it is a class without arguments") from error
    given = trial()
    for course in method.courses(given):
        for field, found in (("estimate", course.estimate), ("sigma", course.sigma)):
            if found.shape != given.measured.shape:
                expected = f"a row for each step and a column for each error, {given.measured.shape}"
                raise SystemExit(f"METHODS: {name!r}: {field} has shape {found.shape}; expected {expected}")
    try:
        check_causal(method, given, range(3))
        if isinstance(method, Deciding):
            check_asked(method, given, _TRIED_UM)
    except Peeked as error:
        raise SystemExit(
            f"METHODS: {error}; in each row of `estimate` and `sigma` only measurements of earlier rows may be used"
        ) from None
    return method
