"""`python -m tests.benches.roll_out PACKAGE`: the Ansible collection on six computers, and on a new one of an old name.

Boots five Debians in containers without a network, which Ansible reaches by SSH through nsenter; the sixth is missing.
Each polls an emulated module. Prints a table of what was tried. As root; needs mmdebstrap, systemd-container,
openssh-client and ansible-playbook.
"""

import json
import os
import re
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from shutil import copy
from subprocess import CompletedProcess, run

from tests.benches.bad_packages import BadPackage
from tests.benches.booted_debian import BootedDebian, minimal_debian
from tests.benches.service_under_systemd import CONFIG, TriedUnit

COLLECTION = Path(__file__).parents[2] / "deploy" / "ansible"
PRESENT = ("mill1", "mill2", "mill3", "lathe1", "lathe2")
KILLED, AWAY = "mill3", "lathe3"
NEXT = "99"
_PROGRAM = "/srv/machine/opt/talc-gateway/bin/python"
"""Of the emulated module, which is there before the gateway."""
MACHINE = f"""[Service]
ExecStart=/bin/sh -c 'exec {_PROGRAM} -u -m simulators.devices adam6015 /srv/scenario.toml >/run/machine.toml'
[Install]
WantedBy=multi-user.target
"""
SCENARIO = "[[at]]\ns = 0\nvalues = [20.0, 21.0, 22.0, 23.0, 24.0, 25.0, 26.0]\n"
SHARED = "[grid]\nstep_s = 30.0\n[storage]\npath = '/var/lib/talc-gateway/gateway.sqlite'\n"
KIND = "[machine]\nname = '{{ inventory_hostname }}'\nkind = '{{ kind }}'\n"
LATER = "[sensor_check]\nenabled = false\n"
"""What the second roll-out changes for all, and what kills one: `check` cannot know the computer's addresses."""
DEADLY = "[metrics]\nlisten = '192.0.2.1:9464'\nallow_unencrypted = true\n"


class Site:
    """A controller's folder with inventory, parts and packages."""

    def __init__(self, folder: Path, packages: Path, key: Path) -> None:
        self.folder, self._packages, self._key = folder, packages, key
        (folder / "gateways").mkdir(parents=True)
        collections = folder / "collections" / "ansible_collections" / "talc"
        collections.mkdir(parents=True)
        (collections / "gateway").symlink_to(COLLECTION)
        for kind in ("mill", "lathe"):
            self.part(f"kind-{kind}", KIND)
        self.part("shared", SHARED)

    def part(self, name: str, text: str) -> None:
        """Write a part of the configurations."""
        (self.folder / "gateways" / f"{name}.toml.j2").write_text(text, encoding="utf-8")

    def roll_out(self, version: str, leaders: Mapping[str, int], *more: str) -> "CompletedProcess[str]":
        """Run the collection's playbook."""
        return self.play("roll_out", leaders, *more, "--extra-vars", f"gateway_version={version}")

    def play(self, playbook: str, leaders: Mapping[str, int], *more: str) -> "CompletedProcess[str]":
        """Run a playbook of the collection. leaders: of those that are there, the first process, seen from here"""
        hosts = {}
        for name in (*PRESENT, AWAY):
            inside = f"nsenter --target {leaders[name]} --all -- /usr/sbin/sshd -i" if name in leaders else "false"
            options = f'-o ProxyCommand="{inside}" -o StrictHostKeyChecking=no -o UserKnownHostsFile=/dev/null'
            hosts[name] = {"ansible_ssh_common_args": options, "kind": re.sub(r"\d", "", name)}
        own = {
            "ansible_user": "root",
            "ansible_ssh_private_key_file": str(self._key),
            "ansible_python_interpreter": "/usr/bin/python3",
            "gateway_packages": str(self._packages),
            "gateway_shared": ["shared.toml.j2", "kind-{{ kind }}.toml.j2"],
            "gateway_watch_s": 30,
        }
        inventory = self.folder / "inventory.json"
        inventory.write_text(json.dumps({"talc_gateways": {"hosts": hosts, "vars": own}}), encoding="utf-8")
        return run(
            ["ansible-playbook", "-i", inventory, f"talc.gateway.{playbook}", *more],
            env={
                **os.environ,
                "ANSIBLE_COLLECTIONS_PATH": str(self.folder / "collections"),
                "ANSIBLE_PIPELINING": "1",
                "ANSIBLE_SSH_CONTROL_PATH_DIR": str(self.folder / f"ssh-{min(leaders.values())}"),
                "ANSIBLE_NOCOLOR": "1",
            },
            capture_output=True,
            text=True,
            check=False,
        )


def recap(done: "CompletedProcess[str]") -> dict[str, dict[str, int]]:
    """By host, its counts in Ansible's last lines."""
    rows = re.findall(r"^(\w+) +: (ok=.*)$", done.stdout.partition("PLAY RECAP")[2], re.MULTILINE)
    return {host: {name: int(n) for name, n in re.findall(r"(\w+)=(\d+)", text)} for host, text in rows}


@contextmanager
def computers(root: Path, folder: Path, names: tuple[str, ...]) -> Iterator[dict[str, BootedDebian]]:
    """Guests that share what they do not change."""
    with ExitStack() as stack:
        guests = {}
        for name in names:
            places = {part: folder / name / part for part in ("upper", "work", "root")}
            for place in places.values():
                place.mkdir(parents=True)
            options = f"lowerdir={root},upperdir={places['upper']},workdir={places['work']}"
            run(["mount", "-t", "overlay", "overlay", "-o", options, places["root"]], check=True)
            stack.callback(_unmount, places["root"])
            guests[name] = stack.enter_context(BootedDebian(places["root"], folder / name / "console"))
            guests[name].wait_until("grep -q port /run/machine.toml")
        yield guests


def _unmount(place: Path) -> None:
    run(["umount", "--lazy", place], check=True)


def furnish(root: Path, package: Path, key: Path) -> None:
    """Put a key, the emulated module and its program into the Debian that all share."""
    run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", key], check=True)
    (root / "root/.ssh").mkdir(mode=0o700, exist_ok=True)
    copy(key.with_suffix(".pub"), root / "root/.ssh/authorized_keys")
    run(["dpkg-deb", "--extract", package, root / "srv/machine"], check=True)
    (root / "srv/scenario.toml").write_text(SCENARIO, encoding="utf-8")
    unit = root / "etc/systemd/system/machine.service"
    unit.write_text(MACHINE, encoding="utf-8")
    run(["systemctl", f"--root={root}", "--quiet", "enable", "machine"], check=True)


def own_part(guest: BootedDebian) -> str:
    """The machine's own part: where its module is."""
    bus = guest.run("cat /run/machine.toml")
    channels = ", ".join(f"t{n} = {n}" for n in range(7))
    device = f"profile = 'advantech_adam6015'\nchannels = {{ {channels} }}\n"
    return f"{bus}\n[[device]]\nname = 'adam'\nbus = 'bus1'\n{device}"


def well(guest: BootedDebian) -> tuple[str, bool, str]:
    """Version, whether all is well, and the fingerprint of what runs."""
    version = guest.run("cat /opt/talc-gateway/version").strip()
    status = json.loads(guest.tried(f"talc-gateway status --json {CONFIG}").stdout)
    return version, bool(status["well"] and status["applied"]), guest.run(f"sha256sum {CONFIG}").split()[0]


def tries(site: Site, version: str, root: Path, folder: Path) -> Iterator[TriedUnit]:
    """Everything in its order."""
    with computers(root, folder, PRESENT) as guests:
        leaders = {name: guest.leader for name, guest in guests.items()}
        for name, guest in guests.items():
            site.part(name, own_part(guest))
        site.part(AWAY, "")
        site.part("shared", SHARED + "[probing]\narmed = true\n")
        refused = site.roll_out(version, leaders)
        seen = "only a machine's own part" in refused.stdout
        yield TriedUnit("a shared part that arms", seen and refused.returncode != 0, "refused, nothing installed")
        site.part("shared", SHARED)
        first = recap(done := site.roll_out(version, leaders))
        good = all(first[name]["failed"] == 0 for name in PRESENT) and first[AWAY]["unreachable"] == 1
        yield TriedUnit("first roll-out: five install, one is not there", good, str(first) if good else tail(done))
        for guest in guests.values():
            guest.wait_until(f"talc-gateway status {CONFIG}")
        before = {name: well(guest) for name, guest in guests.items()}
        again = recap(site.roll_out(version, leaders))
        yield TriedUnit(
            "the same once more changes nothing", all(again[name]["changed"] == 0 for name in PRESENT), str(again)
        )
        site.part("kind-mill", KIND + "[grid]\nstep_s = 20.0\n")
        done = site.roll_out(NEXT, leaders, "--limit", "mill1")
        site.part("kind-mill", KIND)
        now = well(guests["mill1"])
        same = now == before["mill1"] and "back at" in done.stdout
        yield TriedUnit(
            "a table that stands in two parts: `check` of the new program refuses it",
            same,
            "as before" if same else f"{before['mill1']} {now} {tail(done)}",
        )
        site.part("shared", SHARED + LATER)
        site.part(KILLED, own_part(guests[KILLED]) + DEADLY)
        second = recap(done := site.roll_out(NEXT, leaders))
        for guest in guests.values():
            guest.wait_until(f"talc-gateway status {CONFIG}")
        after = {name: well(guest) for name, guest in guests.items()}
        others = [name for name in PRESENT if name != KILLED]
        good = all(after[name][:2] == (NEXT, True) and after[name][2] != before[name][2] for name in others)
        yield TriedUnit("an update with another configuration: four changed", good, str(after) if good else tail(done))
        yield TriedUnit(
            "the one that its configuration kills is back by itself",
            after[KILLED] == before[KILLED] and second[KILLED]["rescued"] == 1 and "is back at" in done.stdout,
            f"{after[KILLED]} {second[KILLED]}",
        )
        yield TriedUnit("the one that is not there is named", second[AWAY]["unreachable"] == 1, str(second[AWAY]))
        frames = steps(guests["lathe2"])
        site.play("back_up", leaders, "--limit", "lathe2")
        kept = site.folder / "backups" / "lathe2.sqlite"
        size = kept.stat().st_size if kept.is_file() else 0
        yield TriedUnit("what it has learnt is on the controller", size > 0, f"{size} bytes")
    with computers(root, folder / "new", ("lathe2",)) as guests:
        (guest,) = guests.values()
        site.part("lathe2", own_part(guest))
        done = site.roll_out(NEXT, {"lathe2": guest.leader}, "--limit", "lathe2")
        guest.wait_until(f"talc-gateway status {CONFIG}")
        found = steps(guest)
        yield TriedUnit(
            "a new computer of that name, one command: it goes on",
            done.returncode == 0 and found[0] == frames[0] and found[1] > frames[1],
            f"steps {frames} before, {found} after",
        )


def steps(guest: BootedDebian) -> tuple[int, int]:
    """The first and the last grid step that its database has."""
    text = guest.run("talc-gateway db stats /var/lib/talc-gateway/gateway.sqlite")
    first, last = re.findall(r"steps (\d+) to (\d+)", text)[0]
    return int(first), int(last)


def tail(done: "CompletedProcess[str]") -> str:
    """Of a playbook that went wrong."""
    return (done.stdout + done.stderr)[-6000:]


def main() -> None:
    """Print the table; exit code 1 if something did not go as it should."""
    package, bad = Path(sys.argv[1]).resolve(), 0
    version = run(
        ["dpkg-deb", "--field", package, "Version"], capture_output=True, text=True, check=True
    ).stdout.strip()
    with tempfile.TemporaryDirectory(dir="/var/tmp") as name:
        folder = Path(name)
        packages = folder / "packages"
        packages.mkdir()
        copy(package, packages)
        run(["dpkg-deb", "--raw-extract", package, folder / "contents"], check=True)
        same = "main()"  # nothing is bad in it
        BadPackage(f"talc-gateway_{NEXT}_amd64", "gateway/__main__", same, same).build(folder / "contents", packages)
        root = minimal_debian(folder / "root", "openssh-server")
        furnish(root, package, folder / "key")
        site = Site(folder / "site", packages, folder / "key")
        print("| tried | | seen |\n|---|---|---|")
        for row in tries(site, version, root, folder / "guests"):
            print(f"| {row.what} | {'as it should' if row.good else 'NO'} | {row.seen} |", flush=True)
            bad += not row.good
    sys.exit(bool(bad))


if __name__ == "__main__":
    main()
