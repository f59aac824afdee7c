"""Defects that the bench with the failing disk has to find: on a disk that works, nobody notices them."""

from collections.abc import Mapping, Sequence

from gateway.nc import link
from gateway.storage import mending, waiting
from tests.benches.changed_source import SourceChange

PLANTED: Mapping[str, Sequence[SourceChange]] = {
    # Rows that could not be stored do not wait any more.
    "not put back": (SourceChange(waiting, "for item in reversed(list(items)):", "for item in ():"),),
    # Whether anything can be stored makes no difference to the offsets.
    "goes on unstored": (
        SourceChange(link, "stored,\n            earlier.paused,", "lambda: True,\n            earlier.paused,"),
    ),
    # The damaged file leaves its place before the new one is complete.
    "moved first": (
        SourceChange(
            mending, "counts, lost = _copy(path, target)", "path.rename(aside); counts, lost = _copy(aside, target)"
        ),
        SourceChange(mending, "aside.hardlink_to(path)", "pass"),
    ),
}
