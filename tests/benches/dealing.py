"""The order of the tests, dealt out to several workers so that none has a long one left when the others have ended."""

from collections.abc import Callable, Hashable, Iterable, Sequence
from typing import TypeVar

Test = TypeVar("Test")


def dealt(
    tests: Sequence[Test], file: Callable[[Test], Hashable], minutes: Callable[[Test], float | None], workers: int
) -> list[Test]:
    """One hand after another, each as long as xdist's first share of a worker: slow files first, the longest on top.

    The slow tests of a file stay together, as they may share what took long to prepare. Each file goes to the worker
    that has the least to do so far. The other tests follow in their order; a worker that has none left takes some from
    the end of another's share.

    minutes: about how long the slow tests of a test's file take in all; None if the test is not slow
    """
    slow: dict[Hashable, list[Test]] = {}
    lasts: dict[Hashable, float] = {}
    quick: list[Test] = []
    for test in tests:
        if (known := minutes(test)) is None:
            quick.append(test)
        else:
            slow.setdefault(file(test), []).append(test)
            lasts[file(test)] = max(known, lasts.get(file(test), 0.0))
    hands: list[list[Test]] = [[] for _ in range(workers)]
    busy = [0.0] * workers
    for name in sorted(slow, key=lambda name: -lasts[name]):
        least = min(range(workers), key=busy.__getitem__)
        hands[least] += slow[name]
        busy[least] += lasts[name]
    return _filled(hands, quick)


def _filled(hands: Iterable[list[Test]], quick: list[Test]) -> list[Test]:
    """All hands in a row, each filled with quick tests up to where xdist cuts, as far as the quick tests suffice."""
    hands, made = list(hands), list[Test]()
    total, left = sum(map(len, hands)) + len(quick), list(quick)
    for at, hand in enumerate(hands):
        size = (total - len(made)) // (len(hands) - at)
        missing = max(0, size - len(hand))
        made += [*hand, *left[:missing]]
        left = left[missing:]
    return made + left
