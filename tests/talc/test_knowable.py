"""What spheres tell of each chain: known ranks, simulated noisy cycles of a machine with exact kinematics, plans."""

from typing import Any

import numpy as np
import pytest

from talc.chain import Machine, chain_of
from talc.kinematics import CHAIN
from talc.knowable import SHOWN_UM, Artefacts, Known, Pose, Travel, cheapest, known_by, with_ring, with_spheres
from talc.names import THERMAL_ERRORS
from talc.poses import FREE_SHARE, expected, judged, plan, unmodelled
from talc.probing import report_poses, solve
from tests.benches.exact_chain import RADIUS_M, exact_deviation
from tests.talc.test_chain import CHAINS, machine_of

SPHERE = Artefacts(((RADIUS_M, 0.0, 0.08),))
SIX = [Pose(at, 0) for at in ((0.0, 0.0), (0.0, 90.0), (0.0, 180.0), (0.0, 270.0), (90.0, 0.0), (-90.0, 0.0))]
NINE = Known(THERMAL_ERRORS, (), (), frozenset())
WORK = ((-0.2, 0.2), (-0.2, 0.2), (0.0, 0.2))


def travel_of(chain: str, **changes: Any) -> Travel:
    machine = machine_of(chain)
    for name, value in changes.items():
        object.__setattr__(machine, name, value)
    turns = {axis: (-90.0, 90.0) for axis in machine.chain.rotary if axis != "C"}
    return Travel(machine, turns, WORK)


@pytest.mark.parametrize(
    ("chain", "rank", "unseen", "with_scales"),
    [
        (CHAINS[0], 16, 1, 0),
        (CHAINS[1], 16, 1, 0),
        (CHAINS[2], 15, 2, 1),
        (CHAINS[3], 16, 2, 1),
        ("w b X Y Z B A S t", 16, 2, 1),
        (CHAINS[4], 9, 3, 2),
        (CHAINS[5], 3, 6, 4),
    ],
)
def test_ranks_and_what_one_sphere_cannot_tell(chain: str, rank: int, unseen: int, with_scales: int) -> None:
    travel = travel_of(chain)
    known = known_by(travel, SPHERE)
    assert (len(known.estimated), len(known.unseen)) == (rank, unseen)
    assert len(known_by(travel_of(chain, glass_scales=frozenset("XYZ")), SPHERE).unseen) == with_scales
    for direction in known.unseen:
        errors = np.array([direction.get(name, 0.0) for name in travel.machine.errors])
        assert max(np.abs(SPHERE.rows(travel.machine, pose) @ errors).max() for pose in SPHERE.poses(travel)) < 0.5
        assert np.linalg.norm(travel.tool @ errors, axis=1).max() == pytest.approx(SHOWN_UM, rel=0.05)


def test_a_uniform_scale_reads_as_growth_of_the_table() -> None:
    (direction,) = known_by(travel_of(CHAIN.replace("-", " "), origins_m={}), SPHERE).unseen
    scale = direction["EXX"]
    assert direction == pytest.approx(
        {"EXX": scale, "EYY": scale, "EZZ": scale, "ER0T": scale * RADIUS_M, "EZ0T": scale * 0.08}
    )


def test_the_cheapest_artefact_for_each_kind_of_machine() -> None:
    ring, known = cheapest(travel_of(CHAINS[0]), SPHERE)
    assert (len(ring.spheres_m), len(ring.lengths_m), known.unseen) == (1, 2, ()), "only a known length"
    two, known = cheapest(travel_of(CHAINS[2]), SPHERE)
    assert (len(two.spheres_m), two.lengths_m, known.unseen) == (2, (), ()), "its probe is the length"
    four, known = cheapest(travel_of(CHAINS[5]), SPHERE)
    assert (len(four.spheres_m), four.lengths_m, known.unseen) == (4, (), ())
    assert np.linalg.matrix_rank(np.subtract(four.spheres_m[1:], four.spheres_m[0])) == 3, "not in one plane"


@pytest.mark.parametrize("chain", CHAINS)
def test_stated_uncertainties_are_the_scatter_of_noisy_cycles_and_of_the_tool(chain: str) -> None:
    """2,000 cycles. Readings and tool of the exact machine, with errors also in what is not separate."""
    travel, draw = travel_of(chain), np.random.default_rng(2000)
    machine = travel.machine
    artefacts = with_spheres(travel, SPHERE, 4) if not machine.chain.rotary else with_spheres(travel, SPHERE, 2)
    artefacts = with_ring(travel, artefacts, 0.3)
    known = known_by(travel, artefacts)
    assert known.unseen == ()
    found = plan(travel, artefacts, known, sigma_um=0.8, most_s=200.0, most=30)
    truth = {name: float(draw.uniform(-15, 15)) for name in machine.errors}
    origins = {axis: np.array(at) for axis, at in machine.origins_m.items()}

    def exact(point: Any, angles_deg: Any) -> Any:
        of = dict(zip(machine.chain.rotary, np.radians(angles_deg).tolist(), strict=True))
        return exact_deviation(chain, origins, truth, np.asarray(point), of)

    errors = np.array(list(truth.values()))
    readings = [exact(artefacts.spheres_m[pose.sphere], pose.angles_deg) for pose in found.poses]
    readings.append(artefacts.known_lengths(machine) @ errors)
    columns = [machine.errors.index(name) for name in known.estimated]
    rows = np.vstack([*(artefacts.rows(machine, pose) for pose in found.poses), artefacts.known_lengths(machine)])
    seen = np.concatenate(readings)[:, None] + draw.normal(0.0, 0.8, (len(rows), 2000))
    solved = np.linalg.lstsq(rows[:, columns], seen, rcond=None)[0]
    np.testing.assert_allclose(solved.std(axis=1), found.sigma, rtol=0.05)
    left = []
    for _ in range(60):
        point = np.array([draw.uniform(*side) for side in travel.work_m])
        angles = np.array([draw.uniform(*turn) for turn in travel.turns()])
        jacobian = machine.jacobian(point, np.radians(angles))[:, columns]
        left.append(exact(point, angles)[:, None] - jacobian @ solved)
    rms = float(np.sqrt(np.mean(np.sum(np.square(left), axis=1))))
    assert rms == pytest.approx(float(np.sqrt(np.mean(found.tool_um**2))), rel=0.1), "at other points than planned for"


@pytest.mark.parametrize(("chain", "spheres"), [(CHAINS[5], 1), (CHAINS[5], 2), (CHAINS[2], 1)])
def test_what_a_cycle_is_worth_is_what_exact_machines_with_drawn_errors_keep(chain: str, spheres: int) -> None:
    """By ridge regression, which is another form of the same estimate."""
    travel, draw, size = travel_of(chain), np.random.default_rng(12), 15.0
    machine, artefacts = travel.machine, with_spheres(travel, SPHERE, spheres)
    poses = plan(travel, artefacts, known_by(travel, artefacts), sigma_um=1.0, most_s=120.0, most=30).poses
    rows = np.vstack([artefacts.rows(machine, pose) for pose in poses])
    sizes = np.array([size * RADIUS_M if name == "ER0T" else size for name in machine.errors])
    ridge = np.linalg.inv(rows.T @ rows + np.diag(1 / sizes**2)) @ rows.T
    origins = {axis: np.array(at) for axis, at in machine.origins_m.items()}
    squares = np.zeros(2)
    for _ in range(200):
        truth = dict(zip(machine.errors, draw.normal(0.0, sizes).tolist(), strict=True))

        def exact(point: Any, angles_deg: Any, truth: dict[str, float] = truth) -> Any:
            of = dict(zip(machine.chain.rotary, np.radians(angles_deg).tolist(), strict=True))
            return exact_deviation(chain, origins, truth, np.array(point), of)

        moved = {pose: exact(artefacts.spheres_m[pose.sphere], pose.angles_deg) for pose in set(poses)}
        solved = ridge @ (np.concatenate([moved[pose] for pose in poses]) + draw.normal(0.0, 1.0, len(rows)))
        point, angles = [draw.uniform(*side) for side in WORK], [draw.uniform(*turn) for turn in travel.turns()]
        off = exact(point, angles)
        kept = off - machine.jacobian(np.array(point), np.radians(angles)) @ solved
        squares += off @ off, kept @ kept
    before, after = expected(travel, artefacts, poses, sigma_um=1.0, size=size)
    np.testing.assert_allclose(np.sqrt(squares / 200), [before, after], rtol=0.1)


def test_spheres_on_a_three_axis_mill_are_worth_what_the_page_says() -> None:
    machine = Machine(chain_of(CHAINS[5]), fixed_m={"X": -0.35, "Y": -0.25, "Z": 0.7}, radius_m=RADIUS_M)
    mill, found = Travel(machine, {}, ((-0.3, 0.3), (-0.2, 0.2), (-0.2, 0.2))), []
    two = ((-0.25, -0.15, -0.125), (0.25, 0.15, 0.125))
    four = ((-0.3, -0.2, -0.2), (0.3, 0.2, -0.2), (0.3, -0.2, 0.2), (-0.3, 0.2, 0.2))
    for spheres, touched in ((((0.0, 0.0, 0.0),), 2), (two, 2), (four, 4)):
        poses = [Pose((), n % len(spheres)) for n in range(touched)]
        before, after = expected(mill, Artefacts(spheres), poses, sigma_um=1.0, size=20.0)
        found += [after, before]
    assert found == pytest.approx([7.2, 49, 4.4, 49, 1.1, 49], rel=0.02)


def test_planned_poses_are_better_than_the_usual_six_and_as_short() -> None:
    travel = travel_of(CHAIN.replace("-", " "), origins_m={})
    usual = judged(travel, SPHERE, NINE, SIX, 1.0)
    planned = plan(travel, SPHERE, NINE, sigma_um=1.0, most_s=usual.seconds, most=30)
    assert planned.seconds <= usual.seconds
    assert np.square(planned.tool_um).mean() < 0.8 * np.square(usual.tool_um).mean()
    assert planned.tool_um.max() < 0.8 * usual.tool_um.max()
    assert planned.free_share > FREE_SHARE
    of_all = plan(travel, SPHERE, known_by(travel, SPHERE), sigma_um=1.0, most_s=usual.seconds, most=6).poses
    assert len(of_all) == 6
    assert judged(travel, SPHERE, NINE, of_all, 1.0).tool_um.max() < 0.85 * usual.tool_um.max()
    leaning, shown = (
        next(other.residual_um for other in unmodelled(travel, SPHERE, NINE, poses, 20.0) if other.error == "EB0A")
        for poses in (SIX, of_all)
    )
    assert shown > 3 * leaning, "planned for all errors they show those that are not solved for"
    assert {(-90.0, 90.0), (90.0, 270.0)}.isdisjoint(pose.angles_deg for pose in SPHERE.poses(travel)), "upside down"
    report = report_poses(np.radians([pose.angles_deg for pose in SIX]), RADIUS_M, 0.08, 1.0)
    np.testing.assert_allclose(usual.sigma, report.sigma, rtol=1e-9)


def test_poses_that_do_not_find_an_error_say_so() -> None:
    flat = judged(travel_of(CHAIN.replace("-", " ")), SPHERE, NINE, SIX[:4], 1.0)
    lost = {name for name, sigma in zip(NINE.estimated, flat.sigma, strict=True) if np.isinf(sigma)}
    assert lost == {"EY0A", "EZ0A", "EY0C", "EZ0T"}
    assert np.isinf(flat.tool_um).all()


def test_an_axis_that_leans_is_not_seen_by_nine_errors_and_made_worse() -> None:
    travel = travel_of(CHAIN.replace("-", " "), origins_m={})
    of = {other.error: other for other in unmodelled(travel, SPHERE, NINE, SIX, 20.0)}
    poses = np.radians([pose.angles_deg for pose in SIX])
    moved = np.array(
        [
            exact_deviation("w C' A' X' b Y Z S t", {}, {"EB0A": 20.0}, np.array(SPHERE.spheres_m[0]), {"A": a, "C": c})
            for a, c in poses
        ]
    )
    residual = solve(moved, poses, radius_m=RADIUS_M, height_m=0.08, sigma_um=1.0).residual_rms
    assert of["EB0A"].residual_um == pytest.approx(residual, abs=0.002)
    assert residual < 0.5
    assert of["EB0A"].after_um > 1.8 * of["EB0A"].before_um > 10.0
    assert of["EX0S"].after_um < 1e-9, "EX0C by another name"


def test_a_travel_leaves_out_poses_and_what_is_out_of_reach_is_named() -> None:
    short = Travel(machine_of(CHAINS[0]), {"A": (-40.0, 20.0), "Z": (0.0, 0.25)}, WORK)
    assert {pose.angles_deg[0] for pose in SPHERE.poses(short)} == {-40, -30, -15, 0, 15, 20}, "round, and the ends"
    assert {pose.angles_deg[1] for pose in SPHERE.poses(short)} == {*range(0, 360, 30)}
    assert all(short.reached(SPHERE.spheres_m[0], pose.angles_deg) for pose in SPHERE.poses(short))
    with pytest.raises(ValueError, match="200 0 900"):
        known_by(short, Artefacts(((0.2, 0.0, 0.9),)))
    with pytest.raises(ValueError, match="no point of the work space"):
        known_by(Travel(machine_of(CHAINS[0]), {"Z": (5.0, 6.0)}, WORK), SPHERE)
    known = known_by(short, SPHERE)
    with pytest.raises(ValueError, match="25 s"):
        plan(short, SPHERE, known, sigma_um=1.0, most_s=25.0, most=30)
    assert chain_of(str(short.machine.chain)) == short.machine.chain
