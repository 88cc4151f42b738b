"""Measure how well velocities can be inferred from a policy's observation, for different numbers of frames.

    python benchmarks/observed_velocity.py checkpoint=pretrained:unfixed --frames 1 2 4

The policy acts in its own task, with noise on observations and actions. A network as large as the policy's is fitted on
six of seven worlds. From the last frames it predicts the trunk's velocity, the board's velocity relative to the trunk,
and the board's angular velocity, all in the trunk's frame. Printed are the root mean square errors on the other worlds,
and the standard deviations of the velocities. Steps that are too early in an episode to have all frames are left out.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass

import torch
from torch import Tensor
from torchrl.modules import MLP

from skatemount.agents.trained_policy import TrainedPolicy
from skatemount.envs import MountEnv, MountTask
from skatemount.envs.geometry import rotate_inverse
from skatemount.models.actor_critic import ACTIVATION_CLASSES

ROWS = ("trunk, m/s", "board less trunk, m/s", "board's turning, rad/s")
HELD_OUT = 7
"""One of this many worlds is held out for testing."""


@dataclass
class Experience:
    """Observations and the velocities to infer from them.

    Attributes:
        observation: ``[N, T, observation]``.
        velocity: ``[N, T, 9]``: velocity of the trunk, of the board relative to the trunk, m/s, and angular velocity of
            the board, rad/s, each as x, y, z in the trunk's frame.
        age: ``[N, T]`` control steps since the start of the episode.
    """

    observation: Tensor
    velocity: Tensor
    age: Tensor

    @classmethod
    def collect(cls, agent: TrainedPolicy, worlds: int, steps: int, seed: int) -> Experience:
        """Roll out a policy as in training, with exploration."""
        torch.manual_seed(seed)
        env = MountEnv(MountTask(config=agent.config), num_worlds=worlds, seed=seed)
        velocities, ages = [], []

        def note_velocity() -> None:
            sim = env.sim
            board = rotate_inverse(sim.base_rot, torch.stack((sim.board_lin_vel, sim.board_ang_vel), 1))
            velocities.append(torch.cat((sim.base_lin_vel, board[:, 0] - sim.base_lin_vel, board[:, 1]), 1))
            ages.append(env.episode.step)

        with torch.no_grad():
            state = env.reset()
            observations = []
            for _ in range(steps):
                note_velocity()
                observations.append(state["observation"])
                _, state = env.step_and_maybe_reset(agent.networks.actor(state))
        env.close()
        return cls(torch.stack(observations, 1), torch.stack(velocities, 1), torch.stack(ages, 1))

    def frames(self, count: int, most: int) -> tuple[Tensor, Tensor, Tensor]:
        """Return stacked frames, velocities, and the rows of the worlds to fit on.

        Args:
            count: Number of frames.
            most: Least age of a row in control steps, the same for every count, so that all use the same rows.

        Returns:
            ``[rows, count * observation]`` frames, ``[rows, 9]`` velocities, and ``[rows]`` bool.
        """
        steps = self.observation.shape[1]
        old_enough = self.age[:, most:] >= most
        stacked = torch.cat([self.observation[:, most - ago : steps - ago] for ago in reversed(range(count))], -1)
        world = torch.arange(len(self.observation)).unsqueeze(1).expand_as(old_enough)
        return stacked[old_enough], self.velocity[:, most:][old_enough], world[old_enough] % HELD_OUT > 0


def reading_error(
    agent: TrainedPolicy, inputs: Tensor, velocity: Tensor, fitted: Tensor, epochs: int, seed: int
) -> Tensor:
    """Return the root mean square errors of a fitted network on the held-out rows, ``[9]``.

    Args:
        agent: The policy, for the size of its network.
        inputs: ``[rows, features]``.
        velocity: ``[rows, 9]``.
        fitted: ``[rows]`` bool, rows to fit on.
        epochs: Number of passes over these rows.
        seed: Seed of weights and order.
    """
    torch.manual_seed(seed)
    inputs = ((inputs - inputs[fitted].mean(0)) / (inputs[fitted].std(0) + 1e-3)).clamp(-10, 10)
    size, network = velocity.std(0), agent.config.network
    reader = MLP(
        inputs.shape[1], 9, num_cells=list(network.actor), activation_class=ACTIVATION_CLASSES[network.activation]
    )
    optimizer = torch.optim.Adam(reader.parameters(), 1e-3)
    rows = fitted.nonzero().squeeze(1)
    schedule = torch.optim.lr_scheduler.LinearLR(optimizer, 1.0, 0.05, epochs)
    for _ in range(epochs):
        for part in rows[torch.randperm(len(rows))].split(1024):
            loss = ((reader(inputs[part]) - velocity[part]) / size).square().mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
        schedule.step()
    with torch.no_grad():
        return (reader(inputs[~fitted]) - velocity[~fitted]).square().mean(0).sqrt()


def main() -> None:
    """Collect, fit, and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("policy", help="checkpoint=<what skatemount.evaluate takes>; its task must be of one frame")
    parser.add_argument("--frames", type=int, nargs="+", default=[1, 2, 4])
    parser.add_argument("--worlds", type=int, default=1024)
    parser.add_argument("--steps", type=int, default=150, help="control steps of each world")
    parser.add_argument("--epochs", type=int, default=14)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    torch.set_float32_matmul_precision("medium")
    agent = TrainedPolicy.load(options.policy.removeprefix("checkpoint="))
    if agent.config.observation.history_length != 1:
        sys.exit(
            f"{options.policy} observes {agent.config.observation.history_length} frames; name one that observes 1"
        )
    experience = Experience.collect(agent, options.worlds, options.steps, options.seed)
    most = max(options.frames) - 1
    errors = {}
    for count in options.frames:
        inputs, velocity, fitted = experience.frames(count, most)
        errors[f"{count} frame{'s' if count > 1 else ''}"] = reading_error(
            agent, inputs, velocity, fitted, options.epochs, options.seed
        )
    rows = {"standard deviation": velocity[~fitted].std(0), **errors}
    print(f"{len(velocity):,} steps. Errors of x, y, z:\n\n| | {' | '.join(ROWS)} |\n" + "|---" * 4 + "|")
    for name, values in rows.items():
        cells = [", ".join(f"{x:.3f}" for x in block.tolist()) for block in values.split(3)]
        print(f"| {name} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
