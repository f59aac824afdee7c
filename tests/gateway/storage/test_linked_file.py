"""A database that a symbolic link leads to, such as one on another disk: one lock, and all that belongs to it there."""

from pathlib import Path

import pytest

from gateway.storage.faults import StoreError
from gateway.storage.store import Store
from tests.benches.spoilt_stores import PAGE, make_whole, restarted
from tests.benches.stepped_clock import SteppedClock


@pytest.fixture
def link(tmp_path: Path) -> Path:
    """A link on the small disk to a file on the large one that does not exist yet."""
    (tmp_path / "large").mkdir()
    (tmp_path / "small").mkdir()
    (tmp_path / "small" / "link.sqlite").symlink_to(Path("..") / "large" / "g.sqlite")
    return tmp_path / "small" / "link.sqlite"


def test_a_second_gateway_is_refused_by_whatever_name_it_comes(link: Path) -> None:
    with Store(link, "first", SteppedClock()) as store:
        store.flush()
        for name in (link, link.parent.parent / "large" / "g.sqlite"):
            with pytest.raises(StoreError, match="another gateway writes to it"):
                Store(name, "second", SteppedClock())
    assert [path.name for path in link.parent.iterdir()] == ["link.sqlite"], "nothing was left on the small disk"


def test_a_damaged_file_is_set_aside_where_it_is_and_the_link_leads_to_the_new_one(link: Path) -> None:
    make_whole(link)
    large = link.resolve()
    with large.open("r+b") as file:
        file.seek(PAGE)
        file.write(bytes(20 * PAGE))
    _, mended = restarted(link, "second")
    assert "set aside" in mended
    assert link.is_symlink()
    assert [path.name for path in link.parent.iterdir()] == ["link.sqlite"]
    assert len([path for path in large.parent.iterdir() if ".damaged-" in path.name and path.suffix != ".log"]) >= 1
    assert link.resolve() == large


def test_a_link_to_a_disk_that_is_not_mounted_is_refused_and_makes_no_folder(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    path.symlink_to(tmp_path / "disk" / "talc" / "g.sqlite")
    with pytest.raises(StoreError, match=r"is a link to .*, which cannot be reached; is its disk mounted"):
        Store(path, "first", SteppedClock())
    assert not (tmp_path / "disk").exists()


def test_links_in_a_circle_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "g.sqlite"
    path.symlink_to(path)
    with pytest.raises(StoreError, match="cannot be reached"):
        Store(path, "first", SteppedClock())


def test_a_link_in_the_place_of_the_lock_leads_nobody_to_another_file(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("of somebody else", encoding="ascii")
    (tmp_path / "g.sqlite.lock").symlink_to(victim)
    with pytest.raises(StoreError, match=r"g\.sqlite\.lock: is a symbolic link"):
        Store(tmp_path / "g.sqlite", "first", SteppedClock())
    assert victim.read_text(encoding="ascii") == "of somebody else"
