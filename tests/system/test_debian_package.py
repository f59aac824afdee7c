"""The Debian package: built from the locks, installed in a Debian without a network, run, upgraded, removed, purged.

Then its service, under a systemd that has booted in a container; upgrades by packages that do not work are tried by
`python -m tests.benches.service_under_systemd`, and by dpkg alone in tests/test_maintainer_scripts.py.
"""

import gzip
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from shutil import copytree, rmtree, which

import pytest

from tests.benches.booted_debian import BootedDebian, minimal_debian
from tests.benches.locked import locked
from tests.benches.package_traces import package_traces
from tests.benches.service_under_systemd import PACKAGES, SystemdPace, furnish, tries

pytestmark = [pytest.mark.slow, pytest.mark.peer, pytest.mark.waits(500)]

ROOT = Path(__file__).parents[2]
LIMIT_S = 900.0
LOOPBACK_UP = """
import fcntl, socket, struct
fcntl.ioctl(socket.socket(), 0x8914, struct.pack("16sH14x", b"lo", 0x49))
"""
"""SIOCSIFFLAGS with IFF_UP, IFF_LOOPBACK and IFF_RUNNING: a new network namespace has its loopback down."""
OWN = "opt/talc-gateway"
CONFIG, DATA = "etc/talc-gateway/gateway.toml", "var/lib/talc-gateway"
INIT = f"""
cd /tmp
printf '[[at]]\\ns = 0\\nvalues = [20, 21, 22, 23, 24, 25, 26]\\n' >module.toml
/{OWN}/bin/python -m simulators.devices adam6015 module.toml >at &
until [ -s at ]; do kill -0 $!; sleep 0.1; done
printf 'machine = "lathe"\\nhosts = ["127.0.0.1:%s"]\\n' "$(sed -n 's/^port = //p' at)" >answers.toml
talc-gateway init /{CONFIG} --answers answers.toml
talc-gateway check /{CONFIG}
talc-gateway probe /{CONFIG}
kill $!
stat -c %U:%G:%a /{CONFIG}
"""


def run(*command: str | Path, folder: Path = ROOT) -> str:
    """The output of a command; fails with all of it."""
    done = subprocess.run(list(map(str, command)), cwd=folder, capture_output=True, text=True, timeout=LIMIT_S)
    assert done.returncode == 0, f"{' '.join(map(str, command))}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.fixture
def package_and_debian(tmp_path: Path) -> Iterator[tuple[Path, Path]]:
    """The package, built by the one command; beside it a minimal Debian of this computer's release with Python, systemd
    and chrony."""
    assert which("dpkg-deb"), "Debian's package dpkg"
    assert which("mmdebstrap"), "Debian's package mmdebstrap"
    folder = tmp_path / "package"
    with tempfile.TemporaryDirectory(dir="/var/tmp") as name:  # not on a /tmp without devices
        with ThreadPoolExecutor() as beside:
            root = beside.submit(minimal_debian, Path(name) / "root")
            run("nice", "env", f"PYTHON={sys.executable}", "LEVEL=1", ROOT / "deploy" / "debian" / "build.sh", folder)
        (built,) = folder.glob("talc-gateway_*.deb")
        yield built, root.result()


class InstalledHost:
    """A computer on which the package is installed: no network but loopback, and its own processes."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def run(self, command: str) -> str:
        inside = f"{sys.executable} -c '{LOOPBACK_UP}' && mount -t proc proc {self.root}/proc"
        inside += f" && mount --rbind /dev {self.root}/dev"  # the demo's machine needs pseudo-terminals
        within = f"exec chroot {self.root} sh -ec '{command}'"
        return run("unshare", "--mount", "--net", "--pid", "--fork", "sh", "-ec", f"{inside} && {within}")


def purls(folder: Path) -> set[str]:
    """What the package below this folder lists as its parts."""
    (bill,) = folder.glob("usr/share/doc/*/sbom.cdx.json")
    return {part["purl"] for part in json.loads(bill.read_text(encoding="utf-8"))["components"]}


def check_report(contents: Path, report: Path) -> None:
    """What draws is in a package of its own, and the other one stays small."""
    drawing = {each.split("@")[0] for each in purls(report)}
    assert {"pkg:pypi/matplotlib", "pkg:pypi/fonttools"} <= drawing
    assert not drawing & {"pkg:pypi/numpy", "pkg:pypi/jinja2"}
    size_kib = sum(each.lstat().st_blocks for each in contents.rglob("*")) // 2
    assert size_kib < 300 * 1024


def check_contents(contents: Path, report: Path) -> None:
    """The program, its kernel, its unit and its configuration, and no path of the computer that built it."""
    assert not (contents / "DEBIAN" / "conffiles").exists(), (
        "dpkg asks about them, and the answer of nobody is an error"
    )
    assert not (contents / "etc").exists()
    assert (contents / OWN / "share" / "gateway.toml").is_file()
    assert (contents / "usr/lib/systemd/system/talc-gateway.service").exists()
    scripts = [p for p in (contents / OWN / "bin").iterdir() if p.is_file() and not p.is_symlink()]
    first = {p.name: p.read_bytes().splitlines()[0] for p in scripts}
    assert first["talc-gateway"].startswith(b"#!/opt/talc-gateway/bin/python")
    assert not [name for name, p in zip(first, scripts, strict=True) if b"/tmp/" in p.read_bytes()]
    assert list((contents / OWN).glob("lib/python3.*/site-packages/talc/_kernel*.so"))
    for folder in ("grafana", "nc", "pi", "zenoh"):
        packed = contents / OWN / "share" / folder
        tracked = run("git", "ls-files", ".", folder=ROOT / "deploy" / folder).splitlines()
        assert tracked, folder
        assert [name for name in tracked if not (packed / name).is_file()] == []
    prebuilt = contents / OWN / "share" / "nc" / "linuxcnc" / "prebuilt"
    assert (prebuilt / "talc_errors.so").is_file()
    assert (prebuilt / "made-for").read_text().split()[1].startswith("2.9")
    about = contents / "usr/share/doc/talc-gateway"
    minor = run("/usr/bin/python3", "-c", 'import sys; print("{}.{}".format(*sys.version_info))').strip()
    version = (contents / OWN / "version").read_text().strip()
    wanted = {f"pkg:pypi/{one.replace('==', '@')}" for one in locked(ROOT / "requirements" / "run.lock", minor)}
    wanted |= {f"pkg:pypi/{name}@{version}" for name in ("talc-gateway", "talc-gateway-simulators")}
    left_out = ("setuptools", "pygments", "markdown-it-py", "mdurl")  # build.sh says why
    wanted = {purl for purl in wanted if not purl.startswith(tuple(f"pkg:pypi/{name}@" for name in left_out))}
    assert not purls(contents) & purls(report)
    parts = purls(contents) | purls(report)
    others = {purl for purl in parts - wanted if purl.startswith(("pkg:npm/uplot@", "pkg:github/tessil/robin-map@v"))}
    (binding,) = (one for one in locked(ROOT / "requirements" / "build.lock", minor) if one.startswith("nanobind=="))
    assert len(others) == 2
    assert parts - others == wanted | {f"pkg:pypi/{binding.replace('==', '@')}"}
    notices = (about / "licences.txt").read_text(encoding="utf-8")
    assert "Copyright (c) 2022 Wenzel Jakob" in notices
    assert "Copyright (c) 2017 Thibaut Goetghebuer-Planchon" in notices
    assert (about / "SECURITY.md").is_file()
    for page in run("git", "ls-files", "docs/*.md", "examples/*.py").splitlines():
        assert (about / page).is_file(), page
    shared = contents / "usr/share"
    assert b"talc\\-gateway inspect registers" in gzip.decompress((shared / "man/man1/talc-gateway.1.gz").read_bytes())
    for name in ("bash-completion/completions/talc-gateway", "zsh/vendor-completions/_talc-gateway"):
        assert "_TALC_GATEWAY_COMPLETE" in (shared / name).read_text(encoding="utf-8")
    units = {path.name for path in (contents / "usr/lib/systemd/system").iterdir()}
    assert units == {path.name for path in (ROOT / "deploy" / "systemd").iterdir()}
    assert "python-can" in notices
    (code,) = (contents / OWN).glob("lib/python3.*/site-packages/asyncua/__pycache__/__init__.*.pyc")
    assert int.from_bytes(code.read_bytes()[4:8], "little") == 1, "unchecked-hash, as docs/site.md says"
    unit = (contents / "usr/lib/systemd/system/talc-gateway.service").read_text()
    assert "ExecStart=/opt/talc-gateway/bin/talc-gateway run /etc/talc-gateway/gateway.toml" in unit


def scripts_alone(contents: Path, folder: Path) -> Path:
    """A package with the scripts of the whole one and little to unpack."""
    for name in (f"{OWN}/bin", f"{OWN}/lib", "usr/share"):
        rmtree(contents / name)
    run("dpkg-deb", "--root-owner-group", "-Znone", "--build", contents, folder / "scripts.deb")
    return folder / "scripts.deb"


def check_init(machine: InstalledHost) -> None:
    """The beginning of docs/install-pi.md: from the untouched example to what is on the wires, readable by the
    service."""
    (machine.root / "tmp" / "init.sh").write_text(INIT, encoding="utf-8")
    out = machine.run("sh -e /tmp/init.sh")
    assert f"/{CONFIG}: good. 1 bus, 1 device, 7 channels" in out
    assert "7 of 7 good" in out
    assert out.splitlines()[-1] == "root:talc-gateway:640"
    assert f'path = "/{DATA}/gateway.sqlite"' in (machine.root / CONFIG).read_text(encoding="utf-8")


def check_partition(machine: InstalledHost, install: str) -> None:
    """The data folder as a separate partition: after a purge it is empty, and the mount is where it was."""
    inside = f"mkdir -p /{DATA} && mount -t tmpfs data /{DATA}"
    left = machine.run(
        f"{inside}; {install}; chown talc-gateway: /{DATA}; echo 1 >/{DATA}/gateway.sqlite; mkdir /{DATA}/reports; "
        f"echo 1 >/{DATA}/reports/.day; dpkg --purge talc-gateway >&2; find /{DATA} -mindepth 1; mountpoint /{DATA}; "
        f"umount /{DATA}; rmdir /{DATA}"
    )
    assert left.splitlines()[-1] == f"/{DATA} is a mountpoint"
    assert not any(line.startswith(f"/{DATA}/") for line in left.splitlines())


def test_it_installs_runs_upgrades_and_leaves_without_a_network(
    package_and_debian: tuple[Path, Path], tmp_path: Path
) -> None:
    """One test, because several tests would each build the package on their own worker."""
    assert os.geteuid() == 0, "a chroot needs root"
    package, debian = package_and_debian
    contents, drawing, packages = tmp_path / "contents", tmp_path / "report", debian / PACKAGES
    (report,) = package.parent.glob("talc-gateway-report_*.deb")
    for built, folder in ((package, contents), (report, drawing)):
        run("dpkg-deb", "--raw-extract", built, folder)
    check_contents(contents, drawing)
    check_report(contents, drawing)
    copytree(package.parent, packages)
    machine = InstalledHost(debian)
    before = package_traces(machine.root)
    install = f"dpkg --install /{PACKAGES}/{package.name}"
    machine.run(install)
    good = machine.run(f"cd /; talc-gateway check /{CONFIG}")
    assert f"/{CONFIG}: good. 1 bus, 1 device, 3 channels" in good
    assert "nothing will be learnt and nothing corrected: there is no [nc]" in good
    assert "talc-gateway-report" in machine.run("cd /tmp; touch x; talc-gateway report x 2>&1 || rm x")
    machine.run(f"dpkg --install /{PACKAGES}/{report.name}")
    demo = machine.run("cd /tmp; talc-gateway demo --hours 1 --plain; talc-gateway replay out/demo/gateway.sqlite")
    assert demo.splitlines()[-1] == "identical"
    assert machine.run(f"stat -c %U:%a /{DATA}").strip() == "talc-gateway:750"
    check_init(machine)

    (debian / CONFIG).write_text((debian / CONFIG).read_text().replace('"lathe"', '"press"'), encoding="utf-8")
    (debian / DATA / "gateway.sqlite").write_text("what was learnt", encoding="utf-8")
    machine.run(install)
    assert '"press"' in (debian / CONFIG).read_text(encoding="utf-8")
    assert (debian / DATA / "gateway.sqlite").read_text(encoding="utf-8") == "what was learnt"

    machine.run("dpkg --remove talc-gateway-report talc-gateway")
    assert not (debian / OWN).exists()
    assert (debian / CONFIG).exists()
    assert (debian / DATA / "gateway.sqlite").exists()
    machine.run("dpkg --purge talc-gateway-report talc-gateway")
    assert package_traces(machine.root) == before
    scripts_alone(contents, packages)
    check_partition(machine, f"dpkg --install /{PACKAGES}/scripts.deb")
    assert package_traces(machine.root) == before

    assert which("systemd-nspawn"), "Debian's package systemd-container"
    pace = SystemdPace(watchdog_s=60.0, restart_s=5.0, in_force_um=30)
    furnish(debian, package, pace)
    with BootedDebian(debian, tmp_path / "console") as guest:
        rows = list(tries(guest, pace))
    assert [row for row in rows if not row.good] == []
    assert len(rows) > 20
