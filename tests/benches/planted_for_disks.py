"""Defects that the bench which refuses calls of the disk has to find: on a disk that works, nobody notices them."""

from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

from gateway.nc import NcLink
from gateway.storage import mending, store
from gateway.storage.mending import Known
from gateway.storage.waiting import Waiting
from tests.benches.planted import Defect

_mend, _init = mending.mend, NcLink.__init__


def _moved_first(path: Path, why: str, now: datetime, known: Known) -> str:
    """The damaged file leaves its place before the new one is complete."""
    moved = path.with_name(path.name + ".moved")
    path.rename(moved)
    text = _mend(moved, why, now, known)
    moved.rename(path)
    return text


def _stored_always(link: NcLink, *arguments: Any, **_: object) -> None:
    """Whether anything can be stored makes no difference to the offsets."""
    _init(link, *arguments[:5])


PLANTED: Mapping[str, Defect] = {
    "not put back": ((Waiting, "put_back", lambda *_: None),),
    "goes on unstored": ((NcLink, "__init__", _stored_always),),
    "moved first": ((store, "mend", _moved_first),),
}
