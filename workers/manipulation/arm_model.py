"""The kinematics of an arm, from the URDF of its robot.

Uses Pinocchio (Carpentier et al., "The Pinocchio C++ library", SII 2019).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robbie_robots.workers.manipulation.errors import KinematicsMissing, WrongArm

Floats = NDArray[np.float64]

ITERATIONS = 80
STUCK = 12
"""A descent ends after this number of steps without progress."""
DAMPING = 1e-5
MAX_STEP_RAD = 0.4
CLOSE_M, CLOSE_RAD = 1e-4, 1e-3
"""A solution is at most this far from where the hand should be."""


def pinocchio() -> Any:
    """Return the library.

    Raises:
        KinematicsMissing: it is not installed.
    """
    try:
        import pinocchio as library  # noqa: PLC0415  # an extra: only the robot with the arm needs it
    except ImportError as error:
        raise KinematicsMissing("arms move with Pinocchio: install `pin` (extra 'arm')") from error
    return library


class ArmModel:
    """An arm with a gripper of two fingers. Its own joints are those of the arm without the gripper.

    Args:
        file: the robot's URDF.
        joints: the arm's joints, from the base to the hand.
        fingers: the joints of the gripper; all of them have the same position.
        tip: the frame that the kinematics bring to a pose.
        base: the frame of all poses.

    Raises:
        KinematicsMissing: Pinocchio is not installed.
        WrongArm: the URDF is invalid, or lacks one of these.

    Attributes:
        lower, upper: limits of the arm's joints, (joints,) rad.
        max_speed: their greatest speeds, (joints,) rad/s.
        shoulder: the place of its second joint in the base's frame, where the first one does not move it:
            (3,), m.
        opening_m: greatest position of the gripper, half of its opening.
    """

    def __init__(
        self,
        file: Path,
        joints: Sequence[str],
        fingers: Sequence[str],
        tip: str = "grasp_point",
        base: str = "base_link",
    ) -> None:
        self.pin = pin = pinocchio()
        try:
            self.model = pin.buildModelFromUrdf(str(file))
        except (ValueError, RuntimeError) as error:
            raise WrongArm(f"{file}: cannot read the robot: {error}") from error
        self.file, self.joints, self.tip = file, tuple(joints), tip
        for frame in (tip, base):
            if not self.model.existFrame(frame, pin.FrameType.BODY):
                raise WrongArm(f"{file} has no link {frame!r}")
        self._places = [self._joint_place(name) for name in joints]
        self._finger_places = [self._joint_place(name) for name in fingers]
        self._velocities = [self.model.joints[self.model.getJointId(name)].idx_v for name in joints]
        self.lower = np.array(self.model.lowerPositionLimit[self._places])
        self.upper = np.array(self.model.upperPositionLimit[self._places])
        self.max_speed = np.array(self.model.velocityLimit[self._velocities])
        self.opening_m = float(self.model.upperPositionLimit[self._finger_places[0]])
        self.data = self.model.createData()
        self._tip, self._base = self.link(tip), self.link(base)
        pin.framesForwardKinematics(self.model, self.data, pin.neutral(self.model))
        # The base is fixed to the root of the model.
        self.X_UB = self.data.oMf[self._base].homogeneous.copy()
        second = self.model.getJointId(self.joints[min(1, len(joints) - 1)])
        self.shoulder = (np.linalg.inv(self.X_UB) @ self.data.oMi[second].homogeneous)[:3, 3]

    def link(self, name: str) -> int:
        """Return the number of a link's frame."""
        return int(self.model.getFrameId(name, self.pin.FrameType.BODY))

    def _joint_place(self, name: str) -> int:
        if not self.model.existJointName(name):
            raise WrongArm(f"{self.file} has no joint {name!r} that moves")
        return int(self.model.joints[self.model.getJointId(name)].idx_q)

    def whole(self, positions: Floats, half_opening_m: float) -> Floats:
        """Return the positions of all joints of the model."""
        q = np.zeros(self.model.nq)
        q[self._places] = positions
        q[self._finger_places] = half_opening_m
        return q

    def pose(self, positions: Floats) -> Floats:
        """Return X_BT, the pose of the tip in the base's frame: (4, 4)."""
        pin = self.pin
        pin.forwardKinematics(self.model, self.data, self.whole(positions, 0.0))
        pin.updateFramePlacement(self.model, self.data, self._tip)
        return np.asarray(np.linalg.inv(self.X_UB) @ self.data.oMf[self._tip].homogeneous)

    def is_within_limits(self, positions: Floats) -> bool:
        """Return whether all joints are within their limits."""
        return bool(((positions >= self.lower - 1e-6) & (positions <= self.upper + 1e-6)).all())

    def random(self, chance: np.random.Generator) -> Floats:
        """Return random positions within the limits."""
        return np.asarray(chance.uniform(self.lower, self.upper))

    def descend(self, goal: Floats, begin: Floats) -> Floats | None:
        """Return positions that bring the tip to a pose, by damped least squares from a beginning.

        Source: Wampler, "Manipulator inverse kinematic solutions based on vector formulations and damped
        least-squares methods" (1986); joints that reach a limit stay there.

        Args:
            goal: X_BT, the wanted pose: (4, 4).
            begin: (joints,) rad.

        Returns:
            (joints,) rad, within the limits; None if the descent ends elsewhere.
        """
        pin, model, data = self.pin, self.model, self.data
        wanted = pin.SE3(self.X_UB @ goal)
        positions = np.clip(begin, self.lower, self.upper)
        best, stuck = math.inf, 0
        for _ in range(ITERATIONS):
            q = self.whole(positions, 0.0)
            pin.computeJointJacobians(model, data, q)
            pin.updateFramePlacement(model, data, self._tip)
            error = pin.log6(data.oMf[self._tip].actInv(wanted)).vector
            way_m, turn_rad = math.hypot(*error[:3]), math.hypot(*error[3:])
            if way_m < CLOSE_M and turn_rad < CLOSE_RAD:
                return np.asarray(positions)
            size = way_m + 0.2 * turn_rad
            stuck = 0 if size < 0.98 * best else stuck + 1
            best = min(best, size)
            if stuck > STUCK:
                return None
            jacobian = pin.getFrameJacobian(model, data, self._tip, pin.LOCAL)[:, self._velocities]
            step = self._step(jacobian, error, positions)
            longest = np.abs(step).max()
            if longest > MAX_STEP_RAD:
                step *= MAX_STEP_RAD / longest
            positions = np.clip(positions + step, self.lower, self.upper)
        return None

    def _step(self, jacobian: Floats, error: Floats, positions: Floats) -> Floats:
        """Return the step of the joints; those that would leave their limits stand still."""
        free = np.ones(len(positions), bool)
        step = np.zeros(len(positions))
        for _ in range(2):
            part = jacobian[:, free]
            step[:] = 0.0
            step[free] = part.T @ np.linalg.solve(part @ part.T + DAMPING * np.eye(6), error)
            beyond = ((positions <= self.lower) & (step < 0)) | ((positions >= self.upper) & (step > 0))
            if not beyond.any():
                break
            free &= ~beyond
        return step
