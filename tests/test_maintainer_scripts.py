"""What the Debian package's scripts do, run by dpkg itself, at upgrades that fail, at removal and at a purge.

tests/system/test_debian_package.py tries the whole package under a real systemd, with fewer of the cases.
"""

import os
import subprocess
from pathlib import Path

import pytest

# A root that has this computer's programs and its own files, for dpkg and the package's maintainer scripts.
#
# systemctl and the gateway's program are stand-ins whose behaviour a test sets; a pause takes no time. Nothing
# outside the folder is written, and no rights of root are needed (a user namespace).


DEPLOY = Path(__file__).parents[1] / "deploy"
LIMIT_S = 60.0
OWN, UNIT = "opt/talc-gateway", "usr/lib/systemd/system/talc-gateway.service"
CONFIG, DATABASE = "etc/talc-gateway/gateway.toml", "var/lib/talc-gateway/gateway.sqlite"
ENTER = """
cd "$1"
for name in usr bin sbin lib lib64; do
    if [ -L /$name ]; then ln -sfn "$(readlink /$name)" $name
    elif [ -d /$name ]; then mkdir -p $name && mount --rbind /$name $name; fi
done
mount --bind units usr/lib/systemd/system
mount --bind /dev/null dev/null
shift
exec chroot . env PATH=/stand-ins:/usr/sbin:/usr/bin:/sbin:/bin DEBIAN_FRONTEND=noninteractive "$@"
"""
SYSTEMCTL = """#!/bin/sh
own=/opt/talc-gateway database=/var/lib/talc-gateway/gateway.sqlite
case "$1" in
is-active) test -e /state/active; exit ;;
show) if [ -e $own/ends ]; then echo 1; else echo 0; fi; exit ;;
esac
echo "$1 $(cat $own/version)" >>/state/calls
case "$1" in
start | restart)
    if [ -e $own/does-not-start ]; then rm -f /state/active; exit 1; fi
    if [ -e $own/migrates ]; then cp $database $database.version4 && echo migrated >$database; fi
    touch /state/active
    ;;
stop | disable) rm -f /state/active ;;
esac
"""
"""Records what it is asked for, and by which version."""
PROGRAM = """#!/bin/sh
case "$1" in
check) test ! -e /opt/talc-gateway/refuses ;;
status) if [ -e /opt/talc-gateway/unwell ]; then echo "channels: 0 of 3 good"; exit 3; fi ;;
esac
"""


class SmallDebian:
    """Such a root in a folder, under a systemd that has booted unless `booted` is removed."""

    def __init__(self, folder: Path) -> None:
        self.root = folder / "root"
        folders = (
            "dev",
            "tmp",
            "state",
            "units",
            "stand-ins",
            "etc",
            "opt",
            "run/systemd/system",
            "var/log",
            "var/cache",
        )
        for name in (*folders, "var/lib/dpkg/info", "var/lib/dpkg/updates"):
            (self.root / name).mkdir(parents=True)
        for name in ("dev/null", "var/lib/dpkg/status", "state/calls"):
            (self.root / name).touch()
        for name in ("passwd", "group"):  # its own user, with the number of the only one that the namespace has
            text = {"passwd": "talc-gateway:x:0:0::/:/bin/sh\n", "group": "talc-gateway:x:0:\n"}[name]
            (self.root / "etc" / name).write_text(text, encoding="utf-8")
        self._stand_in("systemctl", SYSTEMCTL)
        for name in ("journalctl", "logger", "sleep"):
            self._stand_in(name, "#!/bin/sh\n")
        for name in ("userdel", "groupdel"):
            self._stand_in(name, f'#!/bin/sh\necho "{name} $1" >>/state/calls\n')

    def _stand_in(self, name: str, text: str) -> None:
        file = self.root / "stand-ins" / name
        file.write_text(text, encoding="utf-8")
        file.chmod(0o755)

    def package(self, version: str, *marks: str, files: tuple[str, ...] = ()) -> str:
        """Build one of the real maintainer scripts. marks: what its program does; files: what else is in it."""
        contents = self.root.parent / f"contents-{version}"
        texts = {f"{OWN}/version": version, f"{OWN}/share/gateway.toml": "example", f"{OWN}/bin/talc-gateway": PROGRAM,
                 UNIT: f"unit of {version}", **{f"{OWN}/{mark}": "" for mark in marks}, **dict.fromkeys(files, version),
                 "DEBIAN/control": _control("talc-gateway", version)}  # fmt: skip
        for name in ("preinst", "postinst", "prerm", "postrm"):
            text = (DEPLOY / "debian" / name).read_text(encoding="utf-8")
            texts[f"DEBIAN/{name}"] = text.replace("@VERSION@", version)
        return self._built(contents, texts)

    def other_package(self, file: str) -> str:
        """Build a package that owns this file."""
        return self._built(self.root.parent / "contents-other", {file: "", "DEBIAN/control": _control("other", "1")})

    def _built(self, contents: Path, texts: dict[str, str]) -> str:
        for name, text in texts.items():
            file = contents / name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text + "\n", encoding="utf-8")
            file.chmod(0o755)
        built = self.root / "tmp" / f"{contents.name}.deb"
        subprocess.run(["dpkg-deb", "--root-owner-group", "-Znone", "--build", contents, built], check=True,
                       capture_output=True)  # fmt: skip
        return f"/tmp/{built.name}"

    def dpkg(self, *arguments: str) -> tuple[int, str]:
        """Exit code, and everything that it prints."""
        command = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-euc", ENTER, "sh", str(self.root)]
        command += ["dpkg", "--force-unsafe-io", "--force-not-root", *arguments]
        done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)
        return done.returncode, done.stdout + done.stderr

    def installed(self, package: str) -> None:
        """Install it, as it must succeed."""
        code, said = self.dpkg("--install", package)
        assert code == 0, said

    def start(self) -> None:
        """The service runs from now on."""
        (self.root / "state/active").touch()

    @property
    def runs(self) -> bool:
        """Whether the service runs."""
        return (self.root / "state/active").exists()

    def calls(self) -> list[str]:
        """What systemctl and others were asked for since the last call, without reading the unit files again."""
        file = self.root / "state/calls"
        lines = [line for line in file.read_text().splitlines() if not line.startswith("daemon-reload")]
        file.write_text("")
        return lines

    def text(self, name: str) -> str:
        """The text of a file; the unit's files are elsewhere."""
        path = Path(name)
        return (self.root / ("units" if name == UNIT else path.parent) / path.name).read_text().strip()

    def write(self, name: str, text: str) -> None:
        """A file below the root."""
        (self.root / name).parent.mkdir(parents=True, exist_ok=True)
        (self.root / name).write_text(text, encoding="utf-8")

    def left(self) -> list[str]:
        """Paths with the product's name, apart from what dpkg itself keeps and what is below another of them."""
        found = [p.relative_to(self.root) for p in self.root.glob("*/**/*talc-gateway*")]
        ours = [p for p in found if p.parts[0] != "units" or p.name == Path(UNIT).name]
        return sorted(
            str(p) for p in ours if "dpkg" not in p.parts and not any("talc-gateway" in q for q in p.parts[:-1])
        )


def _control(name: str, version: str) -> str:
    return (
        f"Package: {name}\nVersion: {version}\nArchitecture: all\nMaintainer: nobody <n@localhost>\nDescription: a test"
    )


pytestmark = pytest.mark.peer


@pytest.fixture
def debian(tmp_path: Path) -> SmallDebian:
    """Version 1 is installed, and its service runs."""
    debian = SmallDebian(tmp_path)
    debian.installed(debian.package("1"))
    debian.write(CONFIG, "mine")
    debian.write(DATABASE, "what was learnt")
    debian.start()
    assert debian.calls() == [], "an installation starts nothing"
    return debian


def is_the_earlier(debian: SmallDebian, said: str, why: str) -> None:
    """Program, unit and database are those of version 1, which runs; dpkg says why, and nothing is left over."""
    assert f"talc-gateway: 2 was not taken into use: {why}" in said
    assert debian.text(f"{OWN}/version") == "1"
    assert debian.text(UNIT) == "unit of 1"
    assert (debian.text(CONFIG), debian.text(DATABASE)) == ("mine", "what was learnt")
    assert debian.runs
    assert debian.left() == ["etc/talc-gateway", OWN, "units/talc-gateway.service", "var/lib/talc-gateway"]
    assert {path.name for path in (debian.root / OWN).iterdir()} == {"bin", "share", "version"}


def test_a_program_that_works_is_taken_into_use_and_the_earlier_one_goes(debian: SmallDebian) -> None:
    debian.installed(debian.package("2"))
    assert debian.calls() == ["restart 2", "try-restart 2"], "the service ran on until then; then those beside it"
    assert (debian.text(f"{OWN}/version"), debian.text(UNIT)) == ("2", "unit of 2")
    assert (debian.text(CONFIG), debian.text(DATABASE)) == ("mine", "what was learnt")
    assert not (debian.root / "opt/talc-gateway.earlier").exists()


def test_a_program_that_refuses_the_configuration_never_interrupts_the_earlier_one(debian: SmallDebian) -> None:
    code, said = debian.dpkg("--install", debian.package("2", "refuses"))
    assert code != 0
    is_the_earlier(debian, said, "it does not accept the configuration")
    assert debian.calls() == []


@pytest.mark.parametrize(
    ("mark", "why"),
    [
        ("does-not-start", "it does not start"),
        ("ends", "it ended by itself within 5 s"),
        ("unwell", "'talc-gateway status' was good before the upgrade and is not any more: channels: 0 of 3 good"),
    ],
)
def test_a_program_that_does_not_work_gives_way_to_the_earlier_one(debian: SmallDebian, mark: str, why: str) -> None:
    code, said = debian.dpkg("--install", debian.package("2", mark))
    assert code != 0
    is_the_earlier(debian, said, why)
    assert debian.calls() == ["restart 2", "stop 2", "reset-failed 1", "start 1"]
    code, said = debian.dpkg("--configure", "talc-gateway")
    assert code != 0
    assert "as 2 did not work; install another package" in said
    debian.installed(debian.package("3"))
    assert debian.text(f"{OWN}/version") == "3"


def test_a_database_that_was_migrated_comes_back_too(debian: SmallDebian) -> None:
    debian.write(f"{DATABASE}.version3", "of an upgrade long ago")
    debian.write(f"{DATABASE}-wal", "of the new program")
    package = debian.package("2", "migrates", "ends")
    (debian.root / f"{DATABASE}.version3").touch()
    _older(debian.root / f"{DATABASE}.version3")
    code, said = debian.dpkg("--install", package)
    assert code != 0
    assert "the database is the one from before the migration" in said
    assert debian.text(DATABASE) == "what was learnt"
    assert debian.text(f"{DATABASE}.failed-upgrade") == "migrated"
    assert debian.text(f"{DATABASE}.version3") == "of an upgrade long ago"
    assert not (debian.root / f"{DATABASE}-wal").exists()


def test_a_gateway_that_was_not_well_before_need_not_be_well_after(debian: SmallDebian) -> None:
    debian.write(f"{OWN}/unwell", "")
    debian.installed(debian.package("2", "unwell"))
    assert debian.text(f"{OWN}/version") == "2"


def test_a_service_that_does_not_run_is_not_started_by_an_upgrade(debian: SmallDebian) -> None:
    (debian.root / "state/active").unlink()
    debian.installed(debian.package("2"))
    assert debian.calls() == ["try-restart 2"], "of those beside it that run"
    assert not debian.runs
    assert debian.text(f"{OWN}/version") == "2"


def test_an_upgrade_that_dpkg_breaks_off_leaves_the_service_and_no_second_copy(debian: SmallDebian) -> None:
    debian.installed(debian.other_package("opt/taken"))
    code, said = debian.dpkg("--install", debian.package("2", files=("opt/taken",)))
    assert code != 0
    assert "trying to overwrite '/opt/taken'" in said
    assert debian.calls() == []
    assert debian.runs
    assert debian.text(f"{OWN}/version") == "1"
    assert not (debian.root / "opt/talc-gateway.earlier").exists()


def test_a_running_service_ends_before_it_is_removed_and_a_purge_leaves_nothing(debian: SmallDebian) -> None:
    assert debian.dpkg("--remove", "talc-gateway")[0] == 0
    assert debian.calls() == ["disable 1"], "while its program was there, to take the offsets back"
    assert not debian.runs
    assert (debian.text(CONFIG), debian.text(DATABASE)) == ("mine", "what was learnt")
    assert debian.left() == ["etc/talc-gateway", "var/lib/talc-gateway"]
    debian.write("var/lib/talc-gateway/reports/.day", "hidden")
    assert debian.dpkg("--purge", "talc-gateway")[0] == 0
    assert debian.calls() == ["userdel talc-gateway", "groupdel talc-gateway"]
    assert debian.left() == []


def _older(file: Path) -> None:
    """Make a file older by a day."""
    os.utime(file, (file.stat().st_mtime - 86400.0,) * 2)
