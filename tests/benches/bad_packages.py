"""Newer packages that an upgrade must take back: their program ends itself, or runs and reads nothing."""

import re
from dataclasses import dataclass
from pathlib import Path
from subprocess import run

BREAKS = """        import sqlite3
        from pathlib import Path

        database = Path("/var/lib/talc-gateway/gateway.sqlite")
        with sqlite3.connect(database) as before, sqlite3.connect(f"{database}.version4") as kept:
            before.backup(kept)
        database.write_bytes(b"of a newer program")
        raise RuntimeError("broken on purpose")
"""


@dataclass(frozen=True, slots=True)
class BadPackage:
    """A package of version 99, with one piece of its program replaced."""

    name: str
    module: str
    """Below site-packages, without its suffix."""
    before: str
    after: str
    longest_s: int = 120
    """How long the installation waits until what was well before is well again."""

    def build(self, contents: Path, folder: Path) -> None:
        """Build it from the content of a good one, as NAME.deb in the folder."""
        raw = contents.with_name(self.name)
        run(["cp", "--archive", "--link", contents, raw], check=True)
        for path, pattern, value in (
            ("control", r"^(Version: ).*", "99"),
            ("postinst", r"^(version=).*", "99"),
            ("postinst", r"\b(longest_s=)\d+", str(self.longest_s)),
        ):
            file = raw / "DEBIAN" / path
            text, times = re.subn(pattern, rf"\g<1>{value}", file.read_text(), flags=re.M)
            assert times == 1, f"{path}: {pattern}"
            _replace(file, text)
        _replace(raw / "opt/talc-gateway/version", "99\n")
        (module,) = raw.glob(f"opt/talc-gateway/lib/python3.*/site-packages/{self.module}.py")
        text = module.read_text(encoding="utf-8")
        assert text.count(self.before) == 1, f"{module}: what is replaced has changed"
        _replace(module, text.replace(self.before, self.after))
        for compiled in module.parent.glob(f"__pycache__/{module.stem}.*"):
            compiled.unlink()  # those of the package are not compared with their source
        run(["dpkg-deb", "--root-owner-group", "-Znone", "--build", raw, folder / f"{self.name}.deb"], check=True)
        run(["rm", "-rf", raw], check=True)


def _replace(file: Path, text: str) -> None:
    """Another file of that name and mode: the one before goes on under its other names."""
    mode = file.stat().st_mode
    file.unlink()
    file.write_text(text, encoding="utf-8")
    file.chmod(mode)


_LOOPS = "        if not self._waiting:\n"
BAD_PACKAGES = (
    BadPackage("ends", "gateway/service/clock_watch", _LOOPS, BREAKS + _LOOPS),  # after it has migrated the database
    BadPackage(
        "silent",
        "gateway/acquisition/acquisition",
        "line, self._clock, self._publish, self._notify, self._sequence, before=self._before,",
        "line, self._clock, lambda _: None, self._notify, self._sequence,",
        longest_s=45,
    ),
)


def bad_packages(contents: Path, folder: Path) -> None:
    """What an upgrade must take back: newer packages whose program ends itself, or runs and reads nothing.

    contents: of a good package, as dpkg-deb --raw-extract gives them
    """
    for bad in BAD_PACKAGES:
        bad.build(contents, folder)
