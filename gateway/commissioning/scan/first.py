"""The first configuration of a machine: what its integrator answers, and what a scan found."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from drivers.bus_settings import Baud
from drivers.canopen.settings import CanOpenSettings
from drivers.modbus.settings import ModbusTcpSettings
from drivers.mtconnect.settings import AgentUrl, MachineOfAgent
from drivers.mtconnect.suggest import SuggestedItems
from drivers.opcua.settings import ServerUrl
from drivers.problems import read_settings
from drivers.section import HostName, NotEmpty, Section
from gateway.commissioning.scan.found import Place
from gateway.commissioning.scan.fragment import CONFIRM, merged
from gateway.commissioning.scan.serial import scanned_port
from gateway.commissioning.scan.tcp import scanned_host
from gateway.config.fields import LOOPBACK, Name
from gateway.config.file import draft, parse
from gateway.config.reading import read_as
from gateway.config.wires import toml_value
from gateway.runtime.written import whole_numbers


def _host(text: str) -> str:
    scanned_host(text)
    return text


def _can_interface(name: str) -> str:
    read_settings(CanOpenSettings, {"interface": "socketcan", "channel": name})
    return name


def _units(text: str) -> str:
    whole_numbers(*ModbusTcpSettings.units, text)
    return text


class SinumerikAnswers(Section):
    """Where the SINUMERIK is, and who the gateway is to it."""

    kind: Literal["sinumerik"]
    url: ServerUrl = "opc.tcp://192.168.214.1:4840"
    """Endpoint of the control's OPC UA server."""
    user: str = "talc"
    """OPC UA user; empty: none, the certificate alone identifies the gateway."""
    folder: NotEmpty = "/etc/talc-gateway"
    """Folder of the password, certificates and key that you make."""


class LinuxCncAnswers(Section):
    """Where the agent is, LinuxCNC's or another control's."""

    kind: Literal["linuxcnc", "agent"]
    host: HostName = "127.0.0.1"
    """Host of the agent."""
    key_file: NotEmpty = "talc.key"
    """A copy of the agent's key; a relative path starts at the configuration's folder."""


class MtConnectAnswers(Section):
    """Where a control's MTConnect agent is."""

    kind: Literal["mtconnect"]
    url: AgentUrl = "http://127.0.0.1:5000"
    """Address of the agent."""
    machine: MachineOfAgent = ""
    """Name or uuid of the machine, if the agent has several; empty: the first."""


ControlAnswers = SinumerikAnswers | LinuxCncAnswers | MtConnectAnswers
"""The answers for each kind of control that a first configuration can have."""


class Answers(Section):
    """What only the integrator knows. The file of `init --answers` holds the same keys."""

    machine: Name
    """Name of the machine; the second part of every published key."""
    serial: tuple[Annotated[str, AfterValidator(scanned_port)], ...] = ()
    """Serial ports of this computer to scan."""
    bauds: tuple[Baud, ...] = ()
    """Speeds to try on them; none: the usual ones."""
    can: tuple[Annotated[str, AfterValidator(_can_interface)], ...] = ()
    """CAN interfaces to scan."""
    slcan: tuple[Annotated[str, AfterValidator(scanned_port)], ...] = ()
    """Serial ports of CAN adapters (slcan), to scan at each usual bit rate."""
    hosts: tuple[Annotated[str, AfterValidator(_host)], ...] = ()
    """Modbus TCP devices and Micro-Epsilon controllers to ask: host, or host:port."""
    units: Annotated[str, AfterValidator(_units)] | None = None
    """Modbus units to ask, such as 1-32,40; none: 1 to 32 on serial lines, 1 and 255 at hosts. Only hosts can have 0
    and 248 to 255."""
    profiles: Mapping[str, NotEmpty] = Field(default_factory=dict)
    """Profiles of your own for devices that no supplied one fits, by place and unit: `"10.0.0.9 1" = "pt8.toml"`."""
    control: Annotated[ControlAnswers, Field(discriminator="kind")] | None = None
    """The numerical control; none: the gateway reads, stores and publishes."""


def read_answers(path: Path) -> Answers:
    """The answers in a TOML file. Raises ConfigError with every problem found."""
    return read_as(Answers, path)


def answers_text(answers: Answers) -> str:
    """A file of answers that `read_answers` reads."""
    simple = answers.model_dump(mode="json", exclude={"profiles", "control"}, exclude_defaults=True)
    lines = [_ANSWERS_HEAD, *_pairs(simple)]
    if answers.profiles:
        lines += ["[profiles]", *_pairs(answers.profiles)]
    if answers.control is not None:
        lines += ["[control]", *_pairs(answers.control.model_dump(mode="json"))]
    return "\n".join(lines) + "\n"


def _pairs(fields: Mapping[str, object]) -> list[str]:
    return [f"{key if key.isidentifier() else toml_value(key)} = {toml_value(value)}" for key, value in fields.items()]


def first_configuration(
    answers: Answers, places: Sequence[Place], path: Path, items: SuggestedItems | None = None, existing: str = ""
) -> str:
    """Text of a whole configuration: everything that was found, nothing armed. `check` accepts it once it has a device.

    items: what the description of an MTConnect agent suggests; None: it was not read.
    existing: an earlier text, of which everything stays; what it lacks is added

    Each line that holds a guess says CONFIRM and how to do so. A file below /etc is the service's, which may not write
    there: its database gets the Debian package's folder. Raises ConfigError: an answer is invalid in a configuration.
    """
    head = existing or _HEAD.format(name=toml_value(answers.machine), listen=toml_value(LOOPBACK))
    if not existing and path.resolve().is_relative_to("/etc"):
        head += _STORAGE
    text = merged(head, places, path)
    config = draft(text, path)
    if answers.control is not None and config.nc is None:
        text += "\n" + _control(answers.control, items or SuggestedItems())
        (parse if config.devices else draft)(text, path)
    return text


def to_confirm(text: str) -> list[tuple[int, str]]:
    """Number of each line that holds a guess, and what to confirm."""
    found = ((number, _CONFIRMED.search(line)) for number, line in enumerate(text.splitlines(), start=1))
    return [(number, match[1]) for number, match in found if match]


_CONFIRMED = re.compile(rf"#.*\b{CONFIRM}: (.*)")

_ANSWERS_HEAD = """\
# What `talc-gateway init` was told; it proposes this when it is run again, and `--answers` takes this file."""

_HEAD = """\
# Written by `talc-gateway init`. A line that says CONFIRM holds a guess: put it right and delete the comment. Nothing
# is written to the control until the two lines marked ARM say so (docs/arming.md).

[machine]
name = {name}

[telemetry]
listen = [{listen}]    # this computer only"""

_STORAGE = """

[storage]
path = "/var/lib/talc-gateway/gateway.sqlite"  # the only folder that the service may write to"""

_STATES = ("spindle_speed", "speed_X", "speed_Y", "speed_Z", "speed_A", "speed_C")

_ORIGIN = f"{CONFIRM}: machine coordinates with the tool's tip where A and C meet"

_PROBING = """\
[probing]
armed = false                      # ARM: true lets the gateway ask for probing cycles
poses_deg = [[0, 0], [0, 90], [0, 180], [0, 270], [90, 0], [-90, 0]]  # {poses}
sphere_radius_mm = 120.0           # CONFIRM: distance of the sphere's centre from the C axis
sphere_height_mm = 80.0            # CONFIRM: height of its centre above the A axis, at A = 0

[compensation]
mode = "monitor"                   # ARM: "compensate" lets it write offsets
bound_um = [20.0, 20.0, 20.0]      # CONFIRM: largest offset of X, Y, Z; raise it after the first test piece
"""


_ONLY_READ = """\
# An MTConnect agent is only read: no probing, and nothing to arm (docs/agent.md). Without probing nothing
# is learnt on this machine; `talc-gateway db import-learnt` brings what another one has learnt.
[compensation]
mode = "monitor"
"""


def _control(control: ControlAnswers, items: SuggestedItems) -> str:
    if isinstance(control, MtConnectAnswers):
        return _mtconnect(control, items)
    if isinstance(control, LinuxCncAnswers):
        nc = [
            f"kind = {toml_value(control.kind)}",
            f"host = {toml_value(control.host)}",
            f"key_file = {toml_value(control.key_file)}  # CONFIRM: copy the agent's key to there, chmod 600",
        ]
        poses = (
            "those of [TALC] in LinuxCNC's INI file"
            if control.kind == "linuxcnc"
            else "CONFIRM: A and C of each of its poses"
        )
    else:
        folder = Path(control.folder)
        nc = ['kind = "sinumerik"', f"url = {toml_value(control.url)}"]
        if control.user:
            password = toml_value(str(folder / "nc-password"))
            nc += [
                f"user = {toml_value(control.user)}",
                f"password_file = {password}  # CONFIRM: contains only this user's password, chmod 600",
            ]
        files = (
            ("certificate", "gateway.der", "the gateway's; the control must trust it"),
            ("private_key", "gateway_key.pem", "its key, chmod 600"),
            ("server_certificate", "control.der", "copied from the control, so that no other is accepted"),
        )
        nc += [
            f"{name} = {toml_value(str(folder / file))}  # CONFIRM: make it (docs/nc.md): {what}"
            for name, file, what in files
        ]
        nc += [
            "axis_numbers = {X = 1, Y = 2, Z = 3, A = 4, C = 5}  # CONFIRM: number of each machine axis on the control",
            f"origin_mm = [0.0, 0.0, 0.0]  # {_ORIGIN}",
            "[nc.nodes]",
            '# probe_in_spindle = "/Plc/..."  # CONFIRM: a bit of the machine builder; without it any tool may probe',
            '# drives_on = "/Plc/..."  # CONFIRM: likewise; without it the gateway does not notice drives that are off',
            "[nc.compensation]",
            'signs = [-1, -1, -1]  # CONFIRM: with a dial gauge, before mode = "compensate" (docs/nc.md)',
        ]
        poses = "CONFIRM: A and C of each pose, as in TALC_GUD.DEF"
    return "\n".join((*_states(_STATES), "", "[nc]", *nc, "", _PROBING.format(poses=poses)))


def _states(names: Iterable[str]) -> Iterator[str]:
    yield "# Machine states that models may use as inputs."
    for name in names:
        yield from ("[[state]]", f"name = {toml_value(name)}")


def _mtconnect(control: MtConnectAnswers, items: SuggestedItems) -> str:
    """Where the agent has no item, its field has an id that must be replaced, or is left out."""
    why = "read from the agent; compare with its /probe"
    lines = [*_states(items.states), ""] if items.states else []
    lines += ["[nc]", 'kind = "mtconnect"', f"url = {toml_value(control.url)}"]
    if control.machine:
        lines.append(f"machine = {toml_value(control.machine)}")
    elif items.machine:
        lines.append(f"machine = {toml_value(items.machine)}  # {CONFIRM}: the agent's first; it has others")
    for name in ("mode", "program", "tool", "emergency_stop"):
        if name in items.named:
            lines.append(f"{name} = {toml_value(items.named[name])}  # {CONFIRM}: {why}")
        else:
            lines.append(f'# {name} = ""  # {CONFIRM}: id of a data item, from the agent\'s /probe, if it has one')
    lines += [f"origin_mm = [0.0, 0.0, 0.0]  # {_ORIGIN}", "[nc.positions]"]
    for axis in "XYZAC":
        item = items.positions.get(axis)
        told = why if item else f"not found; id of the position of {axis}, from the agent's /probe"
        lines.append(f"{axis} = {toml_value(item or f'{axis}abs')}  # {CONFIRM}: {told}")
    if items.states:
        lines.append("[nc.states]")
        lines += [f"{name} = {toml_value(item)}  # {CONFIRM}: {why}" for name, item in items.states.items()]
    return "\n".join((*lines, "", _ONLY_READ))
