"""IK over a grid: right, on one branch, resumable, refused where it does not belong."""

import numpy as np
import pytest

import ik.volume.build as building
import urdf
from armdyn.errors import InputError
from ik.errors import StaleTableError, UnreachableError
from ik.solver import IkSolver
from ik.volume import TargetGrid, TargetStatus, VolumeTable, build_volume


@pytest.fixture(scope="module")
def volume(baxter, small, tmp_path_factory):
    return build_volume(baxter, small, tmp_path_factory.mktemp("volume") / "small.zarr").table


def test_every_reached_posture_holds_its_target_by_yourdfpy(volume, baxter, small, tool_poses) -> None:
    rng = np.random.default_rng(0)
    status, q = np.asarray(volume.status[:]), np.asarray(volume.q[:])
    positions = small.positions()
    chosen = rng.permutation(np.argwhere(status == TargetStatus.REACHED))[:150]
    rotation, position = tool_poses(baxter, q[tuple(chosen.T)])
    assert np.abs(position - positions[tuple(chosen[:, 1:].T)]).max() < 1e-8
    assert np.abs(rotation - small.rotations[chosen[:, 0]]).max() < 1e-8
    reached = q[status == TargetStatus.REACHED]
    assert baxter.limits.margin(reached).min() >= -1e-9
    assert np.isnan(q[status == TargetStatus.UNREACHABLE]).all()


def test_neighbours_are_on_one_branch(volume) -> None:
    assert volume.discontinuity_share() < 0.01
    assert volume.reached_share() > 0.4
    q = np.asarray(volume.q[:])
    steps = np.concatenate([np.abs(np.diff(q, axis=axis)).max(axis=-1).ravel() for axis in (1, 2, 3)])
    assert volume.discontinuity_share(0.05) == pytest.approx(np.mean(steps[~np.isnan(steps)] > 0.05), rel=1e-12)


def test_what_is_given_up_is_out_of_reach_for_a_search_from_anywhere(volume, baxter, small) -> None:
    missed = np.argwhere(np.asarray(volume.status[:]) == TargetStatus.UNREACHABLE)
    chosen = np.random.default_rng(1).permutation(missed)[:200]
    position = small.positions()[tuple(chosen[:, 1:].T)]
    answers = IkSolver(baxter).solve(small.rotations[chosen[:, 0]], position)
    assert answers.reached.mean() < 0.25  # what can be held on another branch only is not on this one


def test_an_interrupted_build_is_continued_by_processes_and_ends_the_same(
    volume, baxter, small, tmp_path, monkeypatch
) -> None:
    path, calls = tmp_path / "halted.zarr", []

    def interrupted(done: int, _total: int) -> None:
        calls.append(done)
        if len(calls) == 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        build_volume(baxter, small, path, progress=interrupted)
    monkeypatch.setattr(building, "build_skeleton", None)  # it is read, not built again
    report = build_volume(baxter, small, path, processes=2)
    assert report.resumed > 0
    assert report.solved < small.targets
    assert np.array_equal(np.asarray(report.table.q[:]), np.asarray(volume.q[:]), equal_nan=True)
    assert build_volume(baxter, small, path).solved == 0


def test_collisions_are_told_where_they_are_asked_for(baxter, tmp_path, complains) -> None:
    near = TargetGrid(np.array([0.3, -0.5, -0.3]), np.array([0.5, -0.1, 0.0]), (8, 12, 8), baxter.line.rotation[None])
    table = build_volume(baxter, near, tmp_path / "near.zarr", collisions=True).table
    status = np.asarray(table.status[:])
    collisions = urdf.CollisionModel(baxter)
    for index in np.argwhere(status != TargetStatus.UNREACHABLE)[::7]:
        touches = collisions.touching(np.asarray(table.q[tuple(index)])) is not None
        assert touches == (status[tuple(index)] == TargetStatus.COLLIDING)
    with complains(StaleTableError):
        build_volume(baxter, near, table.path)


def test_a_volume_of_other_settings_or_targets_is_refused(volume, baxter, other, small, tmp_path, complains) -> None:
    with complains(StaleTableError):
        VolumeTable.open(volume.path, other)
    with complains(InputError):
        build_volume(baxter, TargetGrid(small.low, small.high, (10, 10, 10), small.rotations), volume.path)
    with complains(InputError):
        VolumeTable.open(tmp_path / "none.zarr")
    (tmp_path / "empty").mkdir()
    with complains(StaleTableError):
        VolumeTable.open(tmp_path / "empty")
    far = TargetGrid(np.full(3, 3.0), np.full(3, 3.2), (4, 4, 4), baxter.line.rotation[None])
    with complains(UnreachableError):
        build_volume(baxter, far, tmp_path / "far.zarr")


@pytest.mark.parametrize(
    ("low", "high", "counts"), [([0, 0, 0], [1, 1, 0], (3, 3, 3)), ([0, 0, 0], [1, 1, 1], (3, 1, 3))]
)
def test_grids_that_span_nothing_are_refused(low, high, counts, complains) -> None:
    with complains(InputError):
        TargetGrid(np.array(low), np.array(high), counts, np.eye(3)[None])
