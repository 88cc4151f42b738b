"""How well velocities can be told from what a policy sees: from one frame of its observation, and from several.

    python benchmarks/observed_velocity.py checkpoint=pretrained:unfixed --frames 1 2 4

The policy acts in its own task, with noise on what it sees and on what it does. A network as large as the policy's is
fitted to six worlds of seven: from the last frames it reads the trunk's velocity, the board's relative to the trunk,
and how fast the board turns, all in the trunk's frame. Printed are the root mean square errors on the other worlds,
beside the velocities' standard deviations. Steps too near the start of an episode to have as many frames are left out.
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
HELD_OUT = 7  # of so many worlds one is not fitted to


@dataclass
class Experience:
    """What was seen, and what was to be told from it.

    Attributes:
        seen: ``[N, T, observation]``.
        velocity: ``[N, T, 9]``: trunk, board less trunk, board's turning, each x, y, z of the trunk's frame.
        age: ``[N, T]`` control steps since the start of the episode.
    """

    seen: Tensor
    velocity: Tensor
    age: Tensor

    @classmethod
    def collect(cls, agent: TrainedPolicy, worlds: int, steps: int, seed: int) -> Experience:
        """Let a policy act as it does in training."""
        torch.manual_seed(seed)
        env = MountEnv(MountTask(config=agent.config), num_worlds=worlds, seed=seed)
        velocities, ages = [], []

        def look() -> None:
            sim = env.sim
            board = rotate_inverse(sim.base_rot, torch.stack((sim.board_lin_vel, sim.board_ang_vel), 1))
            velocities.append(torch.cat((sim.base_lin_vel, board[:, 0] - sim.base_lin_vel, board[:, 1]), 1))
            ages.append(env.episode.step)

        with torch.no_grad():
            seen = env.reset()
            observations = []
            for _ in range(steps):
                look()
                observations.append(seen["observation"])
                _, seen = env.step_and_maybe_reset(agent.networks.actor(seen))
        env.close()
        return cls(torch.stack(observations, 1), torch.stack(velocities, 1), torch.stack(ages, 1))

    def frames(self, count: int, most: int) -> tuple[Tensor, Tensor, Tensor]:
        """Frames to read from, velocities to tell, and which of the rows are of worlds to fit to.

        Args:
            count: Frames.
            most: Steps that an episode must have lasted, so that every count is tried on the same rows.
        """
        steps = self.seen.shape[1]
        old_enough = self.age[:, most:] >= most
        stacked = torch.cat([self.seen[:, most - ago : steps - ago] for ago in reversed(range(count))], -1)
        world = torch.arange(len(self.seen)).unsqueeze(1).expand_as(old_enough)
        return stacked[old_enough], self.velocity[:, most:][old_enough], world[old_enough] % HELD_OUT > 0


def reading_error(
    agent: TrainedPolicy, inputs: Tensor, velocity: Tensor, fitted: Tensor, epochs: int, seed: int
) -> Tensor:
    """Root mean square error of a network, as large as the policy's, that reads velocities, ``[9]``."""
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
    """Collect, fit, print."""
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
        sys.exit(f"{options.policy} sees {agent.config.observation.history_length} frames: name one that sees 1")
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
