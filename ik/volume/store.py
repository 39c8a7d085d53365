"""A volume on disk: a zarr group whose blocks are written one by one."""

import hashlib
import os
import secrets
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from armdyn.errors import InputError
from ik.errors import StaleTableError, check_table_belongs_to_robot
from ik.volume.blocks import BlockSolution
from ik.volume.grid import TARGETS_PER_BLOCK_EDGE, Block, TargetGrid, TargetStatus
from urdf import Robot
from urdf.robot import Array

if TYPE_CHECKING:
    import zarr


VOLUME_FORMAT_VERSION = 3
"""Version of the format of volumes; it is raised when a change of the code changes a robot's volume."""
REMOVE_REMEDY = "remove it and build it again with 'armdyn ik volume'"
ZARR_REMEDY = "volumes need zarr: run 'pip install armdyn[volume]'"


@dataclass(frozen=True)
class VolumeTable:
    """The inverse kinematics of a 3-D grid of targets on disk; n joints, m orientations of the tool.

    Attributes:
        path: the zarr directory.
        robot_name: name of the robot.
        joint_names: names of the joints from base to tool.
        grid: the targets.
        q: postures, (m, x, y, z, n) [rad or m]; indexing reads them from disk; nan where a target is unreachable.
        status: result of each target, (m, x, y, z), a value of `TargetStatus`.
        skeleton: postures on the coarse grid from which the blocks were solved, (m, x, y, z, n) [rad or m].
        digests: digest of each finished block, (m, blocks along x, y and z); 0 where a block is not finished.
    """

    path: Path
    robot_name: str
    joint_names: tuple[str, ...]
    grid: TargetGrid
    q: "zarr.Array[Any]"
    status: "zarr.Array[Any]"
    skeleton: Array
    digests: "zarr.Array[Any]"

    @classmethod
    def create(cls, path: Path, robot: Robot, grid: TargetGrid, skeleton: Array, collisions: bool) -> Self:
        """Create an empty volume in a zarr directory, or open it if another process has just created it.

        Args:
            path: the zarr directory.
            robot: the arm.
            grid: the targets.
            skeleton: postures on the coarse grid, (m, x, y, z, n) [rad or m].
            collisions: whether postures with a collision will be marked.

        Raises:
            InputError: zarr is not installed, or the directory cannot be written.
            StaleTableError: the directory contains another volume or other files.
        """
        zarr = _zarr()
        joints, edges = len(robot.joint_names), tuple(min(TARGETS_PER_BLOCK_EDGE, count) for count in grid.counts)
        # Made beside and renamed: whatever happens, a directory of this name is a volume that can be continued.
        unfinished = path.with_name(f".armdyn-{os.getpid()}-{secrets.token_hex(6)}.tmp")
        try:
            group = zarr.create_group(unfinished)
            for name, shape, chunks, kind, empty in (
                ("q", (*grid.shape, joints), (1, *edges, joints), "float64", float("nan")),
                ("status", grid.shape, (1, *edges), "uint8", 0),
                ("digests", grid.block_counts, (1, 1, 1, 1), "uint64", 0),
            ):
                group.create_array(name, shape=shape, chunks=chunks, dtype=kind, fill_value=empty)
            group.create_array("skeleton", data=skeleton)
            group.attrs["armdyn"] = {
                "format": VOLUME_FORMAT_VERSION,
                "robot": robot.name,
                "joints": list(robot.joint_names),
                "fingerprint": robot.fingerprint,
                "grid": grid.describe(),
                "collisions": collisions,
                "skeleton": _digest(skeleton),
            }
            unfinished.rename(path)
        except (OSError, ValueError) as error:  # a name with a null character is a ValueError
            shutil.rmtree(unfinished, ignore_errors=True)
            if path.exists():  # made by another process since the caller looked
                return cls.open(path, robot, collisions)
            why = getattr(error, "strerror", None) or error
            raise InputError(f"{path}: cannot be written ({why}); choose another directory") from error
        return cls.open(path, robot)

    @classmethod
    def open(cls, path: str | Path, robot: Robot | None = None, collisions: bool | None = None) -> Self:
        """Open a volume in a zarr directory.

        Args:
            path: the zarr directory.
            robot: if given, the robot that the volume must have been built for.
            collisions: if given, whether the volume must have been built with a collision check.

        Raises:
            InputError: zarr is not installed, or the directory does not exist.
            StaleTableError: the directory is not a volume, the volume was built for another robot or other settings, or
                a finished block was changed.
        """
        zarr, source = _zarr(), Path(path)
        if not source.is_dir():
            raise InputError(f"{source}: there is no such volume; build it with 'armdyn ik volume'")
        try:
            group = zarr.open_group(source, mode="r+")
            about = group.attrs["armdyn"]
            if about["format"] != VOLUME_FORMAT_VERSION:
                raise StaleTableError(f"{source}: another version of armdyn wrote it; {REMOVE_REMEDY}")
            table = cls(
                path=source,
                robot_name=about["robot"],
                joint_names=tuple(about["joints"]),
                grid=TargetGrid.from_description(about["grid"]),
                q=group["q"],
                status=group["status"],
                skeleton=np.asarray(group["skeleton"][:]),
                digests=group["digests"],
            )
            table._check(about["skeleton"])
        except (StaleTableError, KeyboardInterrupt):
            raise
        except Exception as error:  # damaged files surface as a dozen exceptions of zarr, json and its compressors
            raise StaleTableError(f"{source}: not an IK volume, or damaged; {REMOVE_REMEDY}") from error
        if robot is not None:
            check_table_belongs_to_robot(source, about, robot, REMOVE_REMEDY)
        if collisions is not None and about["collisions"] != collisions:
            built, wanted = ("with" if checked else "without" for checked in (about["collisions"], collisions))
            raise StaleTableError(f"{source}: it was built {built} '--collisions', not {wanted}; {REMOVE_REMEDY}")
        return table

    def write(self, block: Block, solved: BlockSolution) -> None:
        """Write a solved block to disk; its digest, which marks it as finished, is written last.

        Raises:
            InputError: the disk is full, or the directory was removed.
        """
        place = self.grid.indices(block)
        try:
            self.q[place], self.status[place] = solved.q, solved.status
            self.digests[block] = _digest(*solved)
        except OSError as error:
            raise InputError(
                f"{self.path}: cannot be written ({error.strerror or error}); make room and run the same command again "
                "to continue"
            ) from error

    def _check(self, skeleton: int) -> None:
        """Check the arrays against the grid, and every finished block against its digest.

        Raises:
            StaleTableError: an array or block differs.
        """
        grid = self.grid
        expected = {"q": (*grid.shape, len(self.joint_names)), "status": grid.shape, "digests": grid.block_counts}
        wrong = next((name for name, size in expected.items() if getattr(self, name).shape != size), None)
        if wrong is None and _digest(self.skeleton) != skeleton:
            wrong = "skeleton"
        if wrong is not None:
            raise StaleTableError(f"{self.path}: '{wrong}' is damaged; {REMOVE_REMEDY}")
        for block, digest in np.ndenumerate(np.asarray(self.digests[:])):
            place = grid.indices(block)
            if digest and digest != _digest(np.asarray(self.q[place]), np.asarray(self.status[place])):
                raise StaleTableError(f"{self.path}: the block {block} is damaged; {REMOVE_REMEDY}")

    def unfinished_blocks(self) -> list[Block]:
        """Blocks that are not finished."""
        return [block for block, digest in np.ndenumerate(np.asarray(self.digests[:])) if not digest]

    def reached_share(self) -> float:
        """Share of the targets that are reached without a collision, from 0 to 1."""
        return float(np.mean(np.asarray(self.status[:]) == TargetStatus.REACHED))

    def discontinuity_share(self, limit: float = 0.2) -> float:
        """Share of pairs of neighbouring reached targets between which a joint differs by more than `limit` [rad]."""
        pairs = jumps = 0
        for rotation in range(len(self.grid.rotations)):
            # Slab by slab along x, each with the first plane of the next, so that the whole need not fit into memory.
            for start in range(0, self.grid.counts[0], TARGETS_PER_BLOCK_EDGE):
                q = np.asarray(self.q[rotation, start : start + TARGETS_PER_BLOCK_EDGE + 1])
                q = np.where(
                    (np.asarray(self.status[rotation, start : start + TARGETS_PER_BLOCK_EDGE + 1]) == 1)[..., None],
                    q,
                    np.nan,
                )
                for axis in range(3):
                    inner = q if axis == 0 else q[:TARGETS_PER_BLOCK_EDGE]
                    step = np.abs(np.diff(inner, axis=axis)).max(axis=-1)
                    pairs += int((~np.isnan(step)).sum())
                    jumps += int((step > limit).sum())
        return jumps / max(1, pairs)


def _digest(*arrays: Array | NDArray[np.uint8]) -> int:
    """A digest of 63 bits that is never 0."""
    digest = hashlib.blake2b(digest_size=8)
    for values in arrays:
        digest.update(np.ascontiguousarray(values).tobytes())
    return int.from_bytes(digest.digest(), "big") >> 1 | 1


def _zarr() -> Any:
    try:
        import zarr
    except ImportError as error:
        raise InputError(ZARR_REMEDY) from error
    return zarr
