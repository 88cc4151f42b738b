"""Compare the equations of a ride with the simulation: lean, turning rate and radius of a board under a rigid robot.

    python benchmarks/riding.py
    python benchmarks/riding.py board=carver

Motors that are far stronger than the robot's hold it in its default pose, so it is a statue that does not balance. It
stands a few millimeters beside the middle of the deck. The first table compares the lean with the balance of torques
about the roll axis, (K - m g h + m v^2 h / l) gamma = m g s, with l = L tan(theta) / 2, and the turning rate with the
law of the trucks, omega = v sin(gamma) / l. The last line compares the radius at the trucks' stops with R_min.
"""

from __future__ import annotations

import argparse
import math

import torch
from tensordict import TensorDict

from skatemount.envs import MountEnv, MountTask, riding
from skatemount.envs.physics.base import StartState
from skatemount.utils.tables import new_table, rendered

STATUE = ["robot.kp=1000", "robot.kd=20", "robot.torque_limit=1000", "robot.speed_limit=1000", "physics.timestep=0.002",
          "physics.substeps=20"]  # fmt: skip
STILL = [f"start.{name}=[0,0]" for name in ("x", "y", "yaw", "roll", "pitch", "height", "lin_vel", "ang_vel")]
RIDE = [*STILL, "start.joint_pos=[0,0]", "start.joint_vel=[0,0]", "start.board_speed=[1,1]", "command.speed=[1,1]",
        "command.curvature=[0,0]", "randomization=none", "sensing=ideal", "episode_length=20"]  # fmt: skip
SETTLED, MEASURED = 4.0, 4.0
"""Time before a measurement, and its length, s."""


def rolled(overrides: list[str], shifts: list[float]) -> dict[str, torch.Tensor]:
    """Roll with the robot at another place in each world.

    Args:
        overrides: Settings of the task.
        shifts: Place of the robot to the left of the middle, m.

    Returns:
        Mean speed (m/s), turning rate (rad/s) and lean to the left (rad) after the board has settled, ``[N]`` each, and
        whether the episode has not ended, ``[N]`` bool.
    """
    task = MountTask(stage="ride", overrides=[*RIDE, *STATUE, *overrides])
    env = MountEnv(task, num_worlds=len(shifts), threads=1)

    def shifted(start: StartState, generator: torch.Generator) -> StartState:
        # World i takes the i-th start.
        start.base_pos = start.base_pos.clone()
        start.base_pos[:, 1] += torch.tensor(shifts)[torch.arange(len(start.base_pos)) % len(shifts)]
        return start

    env.set_start_transform(shifted)
    env.reset()
    step = env.mdp.context.control_step
    action = TensorDict({"action": torch.zeros(len(shifts), env.mdp.context.layout.num_joints)}, env.batch_size)
    sums, stands = torch.zeros(4, len(shifts)), torch.ones(len(shifts), dtype=torch.bool)
    for i in range(round((SETTLED + MEASURED) / step)):
        stands &= ~env.step(action.clone())["next", "done"].squeeze(1)
        if i * step >= SETTLED:
            sim, episode = env.sim, env.episode
            now = riding.forward_speed(sim, episode), sim.board_ang_vel[:, 2], riding.lean_left(sim, episode)
            sums += torch.stack((*now, sim.foot_pos_board[..., 1].mean(1)))
    speed, rate, lean, place = sums / round(MEASURED / step)
    env.close()
    return {"speed": speed, "rate": rate, "lean": lean, "place": place, "stands": stands}


def robot_mass(env: MountEnv) -> float:
    """Return the mass of the robot, kg."""
    physics = env.physics
    return float(physics.model.body_subtreemass[physics.index.trunk_body])


def center_of_mass(overrides: list[str]) -> tuple[float, float]:
    """Return how far the standing robot's center of mass is left of its middle and over the roll axis, m."""
    import mujoco

    task = MountTask(stage="ride", overrides=[*RIDE, *overrides])
    env = MountEnv(task, num_worlds=1, threads=1)
    env.reset()
    model, index, board = env.physics.model, env.physics.index, task.config.board
    data = mujoco.MjData(model)
    data.qpos[index.base_qpos] = torch.cat((env.sim.base_pos[0], torch.tensor([1.0, 0.0, 0.0, 0.0]))).numpy()
    data.qpos[index.joint_qpos] = env.sim.joint_pos[0].numpy()
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    _, left, height = data.subtree_com[index.trunk_body].tolist()
    env.close()
    return left, height - board.wheel_radius


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("overrides", nargs="*", help="settings of the task, such as board=carver")
    overrides = parser.parse_args().overrides
    task = MountTask(stage="ride", overrides=[*RIDE, *overrides])
    board = task.config.board
    left, height = center_of_mass(overrides)
    shifts = [-0.015, -0.01, -0.005, 0.0, 0.005, 0.01, 0.015, 0.02]
    found = rolled(overrides, shifts)
    env = MountEnv(task, num_worlds=1, threads=1)
    weight = robot_mass(env) * 9.81
    env.close()
    turn = weight / 9.81 * height / board.steering_length
    print(f"K = {board.roll_stiffness:.1f} N m/rad, m g h = {weight * height:.1f} N m/rad, h = {height:.3f} m")
    print(f"m v^2 h / l = {turn:.1f} N m/rad at 1 m/s; center of mass {1000 * left:.1f} mm to the left")
    made = new_table(
        "start, mm", "place, mm", "lean, deg", "by weight, deg", "turning rate, rad/s", "by law, rad/s", ""
    )
    for i, shift in enumerate(shifts):
        speed, rate, leaned, place = (float(found[name][i]) for name in ("speed", "rate", "lean", "place"))
        lean = weight * (place + left) / (board.roll_stiffness - weight * height + turn * speed**2)
        lean = min(max(lean, -board.max_lean), board.max_lean)
        law = speed * math.sin(leaned) / board.steering_length
        values = (f"{1000 * place:.1f}", f"{math.degrees(leaned):.2f}", f"{math.degrees(lean):.2f}", f"{rate:.3f}")
        made.add_row(f"{1000 * shift:.0f}", *values, f"{law:.3f}", "" if found["stands"][i] else "fell")
    print(f"\n{rendered(made)}")
    angle = math.radians(board.truck_limit)
    soft = [*overrides, "board.truck_stiffness=0", f"start.truck_angle=[{-angle},{-angle}]"]
    at_stop = rolled(soft, [0.0])
    radius = float(at_stop["speed"][0] / at_stop["rate"][0].abs())
    lean = float(at_stop["lean"][0])
    fell = "" if at_stop["stands"][0] else ", fell"
    print(f"\nR_min = {1 / board.max_curvature:.3f} m at a lean of {math.degrees(board.max_lean):.2f} deg")
    print(f"simulated at the stops: {radius:.3f} m at {math.degrees(lean):.2f} deg{fell}")


if __name__ == "__main__":
    main()
