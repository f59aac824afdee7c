"""`talc-gateway nc poses`: which errors of a machine's chain touches of spheres can tell, and at which poses best."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from drivers.base import SetupError
from gateway.config.fields import MOST_POSES
from gateway.config.model import GatewayConfig
from gateway.model.codes import NoticeCode
from gateway.model.text import Language, Text
from talc.chain import LINEAR, Machine, chain_of, unit_of
from talc.frame import FloatArray
from talc.knowable import SHOWN_UM, Artefacts, Known, Point, Pose, Range, Travel, cheapest, known_by, with_ring
from talc.names import THERMAL_ERRORS
from talc.poses import FREE_SHARE, Plan, expected, judged, plan, unmodelled

_SIZE = 20.0
"""Of a usual error, µm or µm/m."""
_MATTERS_UM = 1.0


def travel_of(config: GatewayConfig) -> Travel:
    """The machine of a configuration, how far its axes go, and where it works."""
    section = config.machine
    chain, rotary = chain_of(section.chain), section.rotary
    axes: dict[str, Range] = {axis: (-90.0, 90.0) for axis in chain.rotary if axis != "C"}
    axes |= {axis: of.travel_deg for axis, of in rotary.items() if of.travel_deg is not None}
    axes |= {axis: _side(of.travel_mm) for axis, of in section.linear.items() if of.travel_mm is not None}
    x, y, z = map(_side, section.work_mm)
    machine = Machine(
        chain,
        {axis: _metres(of.origin_mm) for axis, of in rotary.items()},
        {axis: of.sense for axis, of in rotary.items()},
        {axis: of.fixed_mm * 1e-3 for axis, of in section.linear.items()},
        glass_scales=frozenset(axis for axis, of in section.linear.items() if of.feedback == "scale"),
        radius_m=config.probing.sphere_radius_mm * 1e-3,
    )
    return Travel(machine, axes, (x, y, z))


def lines(
    config: GatewayConfig,
    spheres_mm: Sequence[Point],
    ring_mm: float | None,
    most_s: float,
    most_poses: int | None,
    said: Language,
) -> Iterator[str]:
    """The report, line by line. Raises SetupError: nothing can be reached.

    spheres_mm: none: that of [probing]. most_poses: None: as many as [probing] has, of a machine that is probed
    """
    travel, sigma = travel_of(config), config.probing.sigma_um
    most = most_poses or (len(config.probing.poses_deg) if config.machine.corrected else MOST_POSES)
    artefacts = Artefacts(tuple(map(_metres, spheres_mm)) or (_sphere(config, travel.machine),))
    if ring_mm is not None:
        artefacts = with_ring(travel, artefacts, ring_mm * 1e-3)
    try:
        known = known_by(travel, artefacts)
        found = plan(travel, artefacts, known, sigma_um=sigma, most_s=most_s, most=most)
        better, then_known = cheapest(travel, artefacts) if known.unseen else (artefacts, known)
    except ValueError as error:
        raise SetupError(Text(NoticeCode.NOTHING_REACHED, why=str(error))) from error
    yield said("poses.of", chain=config.machine.chain, artefacts=_stands(artefacts, said), sigma_um=sigma)
    yield from _poses(found, travel, artefacts, said)
    yield from _uncertainty(found, known, said)
    before, after = expected(travel, artefacts, found.poses, sigma_um=sigma, size=_SIZE)
    yield said("poses.worth", size=_SIZE, before=before, after=after)
    for direction in known.unseen:
        yield said("poses.unseen", um=SHOWN_UM, errors=_sizes(direction, said))
    if better != artefacts:
        then = plan(travel, better, then_known, sigma_um=sigma, most_s=most_s, most=most)
        _, after = expected(travel, better, then.poses, sigma_um=sigma, size=_SIZE)
        yield said(
            "poses.cheapest", artefacts=_stands(better, said), poses=len(then.poses), s=then.seconds,
            after=after, unseen=len(then_known.unseen),
        )  # fmt: skip
    if known.alike:
        yield said("poses.alike", errors=", ".join(known.alike))
    if config.machine.corrected and not spheres_mm and ring_mm is None:
        yield from _learnt(config, travel, artefacts, found, said)


def _poses(found: Plan, travel: Travel, artefacts: Artefacts, said: Language) -> Iterator[str]:
    axes = travel.machine.chain.rotary
    yield said("poses.planned", poses=len(found.poses), s=found.seconds)
    for n, sphere in enumerate(artefacts.spheres_m):
        angles = [list(pose.angles_deg) for pose in found.poses if pose.sphere == n]
        if axes and angles:
            yield said("poses.at", sphere=_place(sphere, said), axes=", ".join(axes), poses=str(angles))
        elif angles:
            yield said("poses.times", sphere=_place(sphere, said), times=len(angles))


def _uncertainty(found: Plan, known: Known, said: Language) -> Iterator[str]:
    sigmas = dict(zip(known.estimated, found.sigma.tolist(), strict=True))
    if missed := [name for name, sigma in sigmas.items() if sigma == np.inf]:
        yield said("poses.missed", errors=", ".join(missed))
        return
    each = (
        f"{name} {said.number(sigma, '.2g')} {unit_of(name)}{'*' if name in known.combined else ''}"
        for name, sigma in sigmas.items()
    )
    yield said("poses.sigma", errors=", ".join(each))
    yield said("poses.tool", rms=_rms(found.tool_um), most=float(found.tool_um.max()))
    if known.combined:
        yield said("poses.while")
    if found.free_share < FREE_SHARE:
        yield said("poses.hidden", percent=100 * found.free_share, wanted=100 * FREE_SHARE)


def _learnt(
    config: GatewayConfig, travel: Travel, artefacts: Artefacts, planned: Plan, said: Language
) -> Iterator[str]:
    """What the nine errors that the gateway learns make of others, with the configured poses and the planned ones."""
    nine = Known(THERMAL_ERRORS, (), (), frozenset())
    yield said("poses.learnt", size=_SIZE)
    for key, poses in (
        ("poses.with_yours", tuple(Pose((a, c), 0) for a, c in config.probing.poses_deg)),
        ("poses.with_planned", planned.poses),
    ):
        found = judged(travel, artefacts, nine, poses, config.probing.sigma_um)
        if np.isinf(found.tool_um).any():
            continue  # so few poses do not find them
        yield said(key, rms=_rms(found.tool_um), most=float(found.tool_um.max()), s=found.seconds)
        for other in unmodelled(travel, artefacts, nine, poses, _SIZE):
            if other.after_um > _MATTERS_UM:
                yield said(
                    "poses.other", error=other.error, before=other.before_um, after=other.after_um,
                    residual=other.residual_um,
                )  # fmt: skip


def _sphere(config: GatewayConfig, machine: Machine) -> Point:
    """As [probing] has it, from the origin of the table's axis."""
    x, y, z = machine.origins_m.get(machine.chain.table, (0.0, 0.0, 0.0))
    return x + config.probing.sphere_radius_mm * 1e-3, y, z + config.probing.sphere_height_mm * 1e-3


def _side(mm: Range) -> Range:
    return mm[0] * 1e-3, mm[1] * 1e-3


def _metres(mm: Point) -> Point:
    x, y, z = mm
    return x * 1e-3, y * 1e-3, z * 1e-3


def _stands(artefacts: Artefacts, said: Language) -> str:
    spheres = said(
        "poses.spheres", n=len(artefacts.spheres_m), at="; ".join(_place(s, said) for s in artefacts.spheres_m)
    )
    rings = artefacts.lengths_m[:1]
    return spheres + "".join(said("poses.ring", mm=length * 1e3, at=_place(at, said)) for at, _, length in rings)


def _place(point: Point, said: Language) -> str:
    return " ".join(f"{axis}{said.number(at * 1e3, '.0f')}" for axis, at in zip(LINEAR, point, strict=True))


def _sizes(direction: Mapping[str, float], said: Language) -> str:
    return ", ".join(f"{name} {said.number(size, '+.3g')} {unit_of(name)}" for name, size in direction.items())


def _rms(um: FloatArray) -> float:
    return float(np.sqrt(np.mean(um**2)))
