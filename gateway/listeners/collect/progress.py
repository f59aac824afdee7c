"""The progress of collecting a machine, as a file: it changes as a whole, and a batch of rows counts from then on."""

from collections.abc import Mapping
from pathlib import Path

import msgspec
from msgspec import Struct

from gateway.runtime.whole_file import write_whole
from gateway.telemetry import keys

_MOST_EPOCHS = 100
"""How many epochs of a table have their end remembered: a backup of the gateway's store may be put back."""
TablePlace = tuple[str, int]
"""An epoch, and the number of the last row of it."""


class CollectProgress(Struct, frozen=True):
    """How far one machine is collected."""

    batch: int = 0
    """Number of the last batch."""
    places: Mapping[str, tuple[TablePlace, ...]] = {}
    """By table: the latest last."""
    moves: tuple[tuple[str, str], ...] = ()
    """Moves of the last batch: files as they were written, and where they belong, both below the site's folder."""

    def place(self, table: str, back: int = 0) -> TablePlace | None:
        """Where the next query continues, or how far an epoch before it is collected; None: at the beginning.

        back: how many epochs before the latest
        """
        places = self.places.get(table, ())
        return places[-1 - back] if back < len(places) else None

    def last(self, table: str, epoch: str) -> int | None:
        """Number of the last row of an epoch; None: none is known."""
        return dict(self.places.get(table, ())).get(epoch)

    def moved_on(self, table: str, epoch: str, last: int) -> "CollectProgress":
        """With everything of an epoch up to a row. Epochs that the gateway does not know now are remembered: its
        database may have been moved away, and come back."""
        before = self.last(table, epoch)
        others = tuple(place for place in self.places.get(table, ()) if place[0] != epoch)
        places = (*others, (epoch, last if before is None else max(last, before)))[-_MOST_EPOCHS:]
        return msgspec.structs.replace(self, places={**self.places, table: places})


def checked_machine(name: str) -> str:
    """A name that gateways have; nothing in it means something in a path. Raises ValueError for any other one."""
    if not keys.MACHINE.fullmatch(name):
        raise ValueError(f"machine {name!r}: no gateway has such a name; expected letters, digits and _")
    return name


_DECODER = msgspec.json.Decoder(CollectProgress)


def load_progress(path: Path) -> CollectProgress:
    """What the file says; nothing is collected if there is none. Raises OSError, ValueError."""
    try:
        return _DECODER.decode(path.read_bytes())
    except FileNotFoundError:
        return CollectProgress()
    except msgspec.DecodeError as error:
        raise ValueError(f"{path}: {error}; restore it and the whole folder from one backup") from error


def save_progress(path: Path, progress: CollectProgress) -> None:
    """Exchange the file; when this returns it is on the disk. Raises OSError."""
    write_whole(path, msgspec.json.encode(progress))
