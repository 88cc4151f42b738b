"""Measure how far feet creep that push sideways, by the impedance of their contacts.

    python benchmarks/foot_contacts.py

The trunk of the robot is held in place, 2 cm lower than its stance on a fixed board, so that the feet press on the
deck. Then the targets of the hips move outward. A fifth of a second later the measurement begins, and lasts a second.
Printed for each ``physics.foot_impedance`` and each angle, as means of the four feet:

* load: force on the deck, N;
* sideways: force along the deck, N;
* a second later: force along the deck at the end, N;
* creep: distance between a foot's places at both times, mm.
"""

from __future__ import annotations

import argparse
import json

import mujoco
import numpy as np

from skatemount import config as configuration
from skatemount.envs.scene import Scene, SceneIndex

LOWER = 0.02
"""Distance between the trunk's height in the stance and the height at which it is held, m."""
IMPEDANCES = ([0.9, 0.95], [0.95, 0.99], [0.99, 0.999])
ANGLES = (0.03, 0.06)
"""Outward steps of the hips' targets, rad."""


class HeldRobot:
    """A robot whose trunk is held above the deck of a fixed board.

    Args:
        impedance: ``physics.foot_impedance``.
    """

    def __init__(self, impedance: list[float]):
        config = configuration.compose("balance", [f"physics.foot_impedance={json.dumps(impedance)}"])
        scene = Scene(config.robot, config.board, config.physics)
        self._model = scene.compile(visuals=False)
        self._data = mujoco.MjData(self._model)
        self._index = SceneIndex.of(scene, self._model)
        self._feet = [self._model.geom(geom.full_identifier).id for geom in scene.robot.foot_geoms]
        self._outward = np.array([[leg.left, 0, 0] for leg in scene.robot.spec.legs]).ravel()
        self._stance = scene.robot.default_pose
        joint = self._model.joint(self._model.body_jntadr[self._index.robot_body])
        self._place, self._speed = int(joint.qposadr[0]), int(joint.dofadr[0])
        self._height = 1.0
        self._set(self._stance)
        mujoco.mj_forward(self._model, self._data)
        bottom = self._data.geom_xpos[self._feet, 2].min() - self._model.geom_size[self._feet[0], 0]
        self._height = 1.0 - bottom + scene.deck_height - LOWER

    def push_outward(self, angle: float) -> tuple[float, float, float, float]:
        """Move the hips' targets outward.

        Args:
            angle: Step of the targets, rad.

        Returns:
            Load and sideways force, N; sideways force a second later, N; and creep, m.
        """
        self._set(self._stance)
        self._run(0.5)
        self._data.ctrl[self._index.actuators] = self._stance + angle * self._outward
        self._run(0.2)
        load, before, start = *self._forces(), self._data.geom_xpos[self._feet].copy()
        self._run(1.0)
        _, after = self._forces()
        return load, before, after, float(np.linalg.norm(self._data.geom_xpos[self._feet] - start, axis=1).mean())

    def _set(self, pose: np.ndarray) -> None:
        mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[self._index.joint_qpos] = pose
        self._data.ctrl[self._index.actuators] = pose
        self._hold()

    def _hold(self) -> None:
        self._data.qpos[self._place : self._place + 7] = [0, 0, self._height, 1, 0, 0, 0]
        self._data.qvel[self._speed : self._speed + 6] = 0

    def _run(self, seconds: float) -> None:
        for _ in range(round(seconds / self._model.opt.timestep)):
            self._hold()
            mujoco.mj_step(self._model, self._data)

    def _forces(self) -> tuple[float, float]:
        """Return the mean force of a foot on the deck, and along it, N."""
        forces, force = [], np.zeros(6)
        for i, contact in enumerate(self._data.contact):
            if {contact.geom1, contact.geom2} & {*self._feet}:
                mujoco.mj_contactForce(self._model, self._data, i, force)
                forces.append([force[0], np.hypot(force[1], force[2])])
        return tuple(np.sum(forces, axis=0) / len(self._feet))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.parse_args()
    names = ["impedance", "angle, rad", "load, N", "sideways, N", "a second later, N", "creep, mm"]
    print(f"| {' | '.join(names)} |", "|---" * len(names) + "|", sep="\n")
    for impedance in IMPEDANCES:
        robot = HeldRobot(impedance)
        for angle in ANGLES:
            load, before, after, creep = robot.push_outward(angle)
            print(f"| {impedance} | {angle} | {load:.1f} | {before:.1f} | {after:.1f} | {1000 * creep:.1f} |")


if __name__ == "__main__":
    main()
