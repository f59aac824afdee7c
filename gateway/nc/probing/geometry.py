"""What a dry run has shown to be free: a control, the poses of its cycle and the sphere. Pure."""

import json
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from math import cos, radians, sin

from drivers.nc import Triple
from gateway.config.controls import SinumerikNc
from gateway.config.model import GatewayConfig
from gateway.config.sections import Probing
from gateway.model.codes import NoticeCode
from gateway.model.text import NOTHING, Text


@dataclass(frozen=True, slots=True)
class Geometry:
    """Where a cycle goes, as far as the configuration tells."""

    control: str
    """Kind and address."""
    poses_deg: tuple[tuple[float, float], ...]
    radius_mm: float
    height_mm: float
    channel: int = 1
    """In which the control's program runs."""
    origin_mm: Triple = (0.0, 0.0, 0.0)
    """Where the control's own positions are at that of the tip; see [nc] origin_mm."""

    @property
    def mark(self) -> str:
        """The same for the same geometry alone; 16 hexadecimal digits."""
        return sha256(json.dumps(asdict(self)).encode()).hexdigest()[:16]

    def centre_mm(self, a_deg: float, c_deg: float) -> Triple:
        """Where the sphere's centre is at these angles of the rotary axes: Rx(a) Rz(c) (R, 0, h)."""
        return centre_mm(self.radius_mm, self.height_mm, a_deg, c_deg)


def centre_mm(radius_mm: float, height_mm: float, a_deg: float, c_deg: float) -> Triple:
    """Where the sphere's centre is at these angles of the rotary axes: Rx(a) Rz(c) (R, 0, h)."""
    a, c = radians(a_deg), radians(c_deg)
    y, z = radius_mm * sin(c), height_mm
    return radius_mm * cos(c), y * cos(a) - z * sin(a), y * sin(a) + z * cos(a)


def geometry_of(config: GatewayConfig) -> Geometry | None:
    """From the sections nc and probing; None without an [nc]."""
    nc, probing = config.nc, config.probing
    if nc is None:
        return None
    poses = tuple((float(a), float(c)) for a, c in probing.poses_deg)
    found = Geometry(
        f"{nc.kind} at {nc.address}", poses, float(probing.sphere_radius_mm), float(probing.sphere_height_mm)
    )
    return replace(found, channel=nc.channel, origin_mm=nc.origin_mm) if isinstance(nc, SinumerikNc) else found


def recorded(geometry: Geometry, what: str | Text, path: str = "") -> Text:
    """What is stored of a dry run that went well. what: its figures; path: see MarksPath"""
    # The store tells texts apart by their words.
    figures = Text(NoticeCode.DRY_RUN_PATH, what=what, path=path) if path else what
    return Text(NoticeCode.DRY_RUN_DONE, control=geometry.control, figures=figures, geometry=geometry.mark, path=path)


def is_of(text: Text, geometry: Geometry) -> bool:
    """Whether a stored text records a dry run of this geometry."""
    return text.code == NoticeCode.DRY_RUN_DONE and text.values.get("geometry") == geometry.mark


def path_of(text: Text) -> str:
    """Mark of the control's path in the text of a dry run; empty: the control told none."""
    return str(text.values.get("path", ""))


def barrier(probing: Probing, *, proven: bool, runs_dry: bool | None, same_path: bool = True) -> Text:
    """Why no cycle may be requested yet; empty: nothing stands against it.

    proven: whether a dry run of this geometry went well, or a cycle of it has measured
    runs_dry: whether the control knows dry runs; None: it has not shown that
    same_path: False: the control tells that its path is not that of any such dry run
    """
    if proven and same_path:
        return NOTHING
    if proven and probing.dry_run == "required":
        return Text(NoticeCode.DRY_RUN_CHANGED)
    if probing.dry_run == "not offered":
        if runs_dry is None:
            return Text(NoticeCode.DRY_RUN_NOT_SHOWN)
        return Text(NoticeCode.DRY_RUN_OFFERED) if runs_dry else NOTHING
    return Text(NoticeCode.DRY_RUN_UNKNOWN if runs_dry is False else NoticeCode.DRY_RUN_WANTED)
