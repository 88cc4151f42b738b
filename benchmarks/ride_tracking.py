"""Measure how a policy follows the commanded turning rate of a ride, and what the errors of the sensors cost.

    python benchmarks/ride_tracking.py checkpoint=pretrained:rider

The policy rides the suite `ride` with deterministic actions: with the true state, with ``sensing=default``, and with
``sensing=default`` without some of its errors. Steps count until the robot falls. Printed for each:

* error: mean of |omega - kappa* v|, rad/s;
* slow: the same of means over one second, rad/s;
* fast: standard deviation of the rest, rad/s;
* correlation of omega and kappa* v, and gain: the factor of kappa* v that fits omega best;
* counted: share of the steps that count.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import torch
from torch import Tensor

from skatemount.agents.trained_policy import TrainedPolicy
from skatemount.envs import riding
from skatemount.evaluation.evaluator import Evaluator
from skatemount.evaluation.suite_task import EvaluationTask, load_suite

NOISE = [f"sensing.{name}=0" for name in (
    "joint_vel_noise", "gyro_noise", "gravity_noise", "board_pos_jitter", "board_rot_jitter"
)]  # fmt: skip
OFFSETS = [f"sensing.{name}=0" for name in ("board_pos_bias", "board_rot_bias", "encoder_offset")]
SENSING = {
    "ideal": ["sensing=ideal"],
    "default": ["sensing=default"],
    "no late targets": ["sensing=default", "sensing.target_delay=[0,0]"],
    "no constant errors": ["sensing=default", *OFFSETS],
    "no noise": ["sensing=default", *NOISE],
}


@dataclass
class Tracking:
    """Turning rates during the first episodes of all worlds.

    Attributes:
        rate: ``[T, N]`` turning rate of the board, rad/s.
        wanted: ``[T, N]`` commanded turning rate, rad/s.
        counted: ``[T, N]`` bool, whether the robot has not fallen yet.
        window: Control steps of a second.
    """

    rate: Tensor
    wanted: Tensor
    counted: Tensor
    window: int

    @classmethod
    def measure(cls, agent: TrainedPolicy, settings: list[str], worlds: int) -> Tracking:
        """Let a policy ride one episode in each world.

        Args:
            agent: The policy.
            settings: The sensing.
            worlds: Number of worlds.

        Returns:
            The turning rates.
        """
        (config,) = EvaluationTask.of(agent, load_suite("ride"), settings).configs.values()
        evaluator = Evaluator(config, num_worlds=worlds)
        env, rates, wanted, counted = evaluator.env, [], [], []

        def watch(step: int) -> None:
            sim, episode = env.sim, env.episode
            if step == 0 or episode.ride_command is None:
                return
            rates.append(sim.board_ang_vel[:, 2].clone())
            wanted.append(episode.ride_command[:, 2] * riding.forward_speed(sim, episode))
            upright = ~episode.terminated
            counted.append(counted[-1] & upright if counted else upright)

        try:
            evaluator.round(agent.policy, 0, watch)
        finally:
            evaluator.close()
        window = round(1 / env.mdp.context.control_step)
        return cls(torch.stack(rates), torch.stack(wanted), torch.stack(counted), window)

    def row(self) -> list[float]:
        """Return error, slow, fast, correlation, gain and counted, as the program prints them."""
        error = self.rate - self.wanted
        whole = self.counted.unfold(0, self.window, 1).all(-1)
        slow = error.unfold(0, self.window, 1).mean(-1)
        fast = self.rate[self.window // 2 :][: len(slow)] - self.rate.unfold(0, self.window, 1).mean(-1)
        rate, wanted = self.rate[self.counted], self.wanted[self.counted]
        values = (
            error[self.counted].abs().mean(),
            slow[whole].abs().mean(),
            fast[whole].std(),
            torch.corrcoef(torch.stack((rate, wanted)))[0, 1],
            (rate * wanted).sum() / wanted.square().sum(),
            self.counted.float().mean(),
        )
        return [float(value) for value in values]


def main() -> None:
    """Print a row for each sensing."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("checkpoint", help="checkpoint=<run, file or pretrained:NAME>")
    parser.add_argument("--worlds", type=int, default=96, help="number of worlds, each of which rides for 20 s")
    parser.add_argument("--sensing", nargs="+", choices=SENSING, default=list(SENSING))
    parser.add_argument("overrides", nargs="*", help="settings, such as physics.threads=1")
    options = parser.parse_args()
    agent = TrainedPolicy.load(options.checkpoint.removeprefix("checkpoint="))
    print("| sensing | error | slow | fast | correlation | gain | counted |")
    print("|---|---|---|---|---|---|---|")
    for name in options.sensing:
        tracking = Tracking.measure(agent, [*SENSING[name], *options.overrides], options.worlds)
        print(f"| {name} |", " | ".join(f"{value:.3f}" for value in tracking.row()), "|", flush=True)


if __name__ == "__main__":
    main()
