"""`python -m tests.benches.service_limits PACKAGE`: reaches the limits of the service, and uses the files of deploy/pi.

Makes a minimal Debian, installs the package, and boots it on its own kernel. Prints a table of what was tried. As
root; needs mmdebstrap and user-mode-linux.
"""

import json
import sys
import tempfile
from pathlib import Path
from shutil import copy
from subprocess import run

from tests.benches.booted_debian import minimal_debian
from tests.benches.service_under_systemd import PACKAGES, SystemdPace, TriedUnit, furnish
from tests.benches.user_mode_debian import UserModeDebian

HERE = Path(__file__).parent
SCRIPTS = ("computer_files_guest.py", "guest_commands.py", "limits_guest.py", "limits_probe.py")
PLACE = "usr/local/lib"
COMMAND = f"env PYTHONPATH=/{PLACE} /opt/talc-gateway/bin/python -m tests.benches.limits_guest /mnt/rows"


def limits(root: Path, folder: Path) -> list[TriedUnit]:
    """Everything that was tried, in a prepared Debian that has the package. folder: for the guest's disks."""
    scripts = root / PLACE / "tests/benches"
    scripts.mkdir(parents=True)
    for name in SCRIPTS:
        copy(HERE / name, scripts / name)
    UserModeDebian(root, folder).run(COMMAND)
    return [TriedUnit(*json.loads(row)) for row in (folder / "rows").read_text(encoding="utf-8").splitlines()]


def main() -> None:
    """Print the table; exit code 1 if something did not go as it should."""
    with tempfile.TemporaryDirectory(dir="/var/tmp") as name:  # not on a /tmp without devices
        root, folder = minimal_debian(Path(name) / "root"), Path(name) / "guest"
        folder.mkdir()
        furnish(root, Path(sys.argv[1]), SystemdPace(restart_s=5.0))
        install = ["chroot", str(root), "dpkg", "--install", f"/{PACKAGES}/talc-gateway.deb"]
        run(install, check=True, stdout=sys.stderr)
        rows = limits(root, folder)
    print("| test | result |\n|---|---|")
    for row in rows:
        print(f"| {row.what} | {'' if row.good else 'WRONG: '}{row.seen} |")
    sys.exit(not all(row.good for row in rows))


if __name__ == "__main__":
    main()
