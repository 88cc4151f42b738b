"""A teacher reads the truth, and acts as it would with its own observation; a training imitates it for a while."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from small_ppo import collect, make, make_networks, same, weights
from tensordict import TensorDict
from tiny import SILENT, TINY
from torch.distributions import Independent, Normal, kl_divergence

from skatemount.agents.interface import feature_indices, observation_layout
from skatemount.agents.teacher import Teacher
from skatemount.agents.trained_policy import TrainedPolicy
from skatemount.config import compose
from skatemount.losses.imitation import imitation_loss
from skatemount.training.callbacks import Callback
from skatemount.training.trainer import Trainer
from skatemount.utils.errors import ConfigError

TAUGHT = [*TINY, *SILENT, "init_from=null", "observation=student", "algorithm.teacher=pretrained:anywhere"]


class Watcher(Callback):
    def __init__(self) -> None:
        self.batches: list[TensorDict] = []
        self.metrics: list[dict[str, float]] = []

    def on_batch_collected(self, trainer: Trainer, batch: TensorDict) -> None:
        self.batches.append(batch.clone())

    def on_iteration_end(self, trainer: Trainer, metrics: dict[str, float]) -> None:
        self.metrics.append(metrics)


def taught(root: Path, *overrides: str) -> tuple[Trainer, Watcher]:
    watcher = Watcher()
    config = compose("unfixed", ["curriculum=none", *TAUGHT, f"logger.root={root}", *overrides])
    trainer = Trainer(config, [], callbacks=[watcher])
    trainer.train()
    trainer.close()
    return trainer, watcher


def test_it_acts_as_with_its_own_observation(tmp_path: Path) -> None:
    # A student that sees no errors and everything that the teacher was trained with
    sees = ["sensing=ideal", "+observation.policy.on_deck={}", "+observation.policy.off_time={history_length: 1}"]
    trainer, watcher = taught(tmp_path, *sees, "episode_length=0.2", "collector.steps_per_env=8", "total_frames=64")
    (batch,) = watcher.batches
    assert batch["next", "done"][:, 1:-1].any(), "episodes have to end within the batch"
    agent = TrainedPolicy.load("pretrained:anywhere")
    layout = observation_layout(trainer.task)
    inputs = feature_indices(layout, agent.card.observation, "observation", "teacher", "the student")
    seen = TensorDict({"observation": batch["observation"][..., inputs]}, batch.batch_size)
    expected = agent.networks.actor.get_dist(seen).base_dist.loc.detach()
    actual = Teacher(agent, trainer.task, "teacher")(batch)
    assert actual[:, 0].isnan().all(), "the frame before the first step is not in the batch"
    torch.testing.assert_close(actual[:, 1:], expected[:, 1:], rtol=1e-4, atol=1e-4)


def test_a_training_imitates_it_and_stops_to(tmp_path: Path) -> None:
    frames = 32 * 30
    settings = ["algorithm.teacher_frames=800", "algorithm.target_kl=null", f"total_frames={frames}"]
    settings += ["algorithm.epochs=4", "algorithm.minibatches=4"]  # enough updates to see it fall
    _, watcher = taught(tmp_path, *settings)
    losses = [metrics.get("Loss/teacher") for metrics in watcher.metrics]
    # The logged loss has its weight, which has fallen to 13/25 at iteration 12.
    assert losses[12] < 0.4 * losses[0]
    assert [i for i, loss in enumerate(losses) if loss is None] == list(range(25, 30))


def test_what_the_teacher_reads_must_be_among_the_truth(tmp_path: Path) -> None:
    message = r"algorithm.teacher=pretrained:anywhere: it reads privileged.base_ang_vel .* as observation=student does"
    with pytest.raises(ConfigError, match=message):
        taught(tmp_path, "observation=onboard", "total_frames=32")


def test_the_settings_of_a_run_name_the_policy_itself(tmp_path: Path) -> None:
    first, _ = taught(tmp_path, "observation=history", "algorithm.teacher=null", "total_frames=32")
    second, _ = taught(tmp_path, "algorithm.teacher=latest", "total_frames=32")
    assert second.run.config["algorithm"]["teacher"] == str(first.run.latest)


def test_the_loss_is_a_divergence() -> None:
    generator = torch.Generator().manual_seed(0)
    loc, teacher, scale = torch.randn(3, 5, 4, generator=generator)
    scale = scale.abs() + 0.1
    ours, theirs = (Independent(Normal(each, scale), 1) for each in (loc, teacher))
    torch.testing.assert_close(imitation_loss(loc, scale, teacher), kl_divergence(theirs, ours).mean())


def test_steps_without_an_action_of_the_teacher_teach_nothing() -> None:
    loc, scale = torch.zeros(2, 4, requires_grad=True), torch.full((2, 4), 0.5)
    teacher = torch.ones(2, 4)
    whole = imitation_loss(loc, scale, teacher)
    teacher[0] = torch.nan
    half = imitation_loss(loc, scale, teacher)
    half.backward()
    torch.testing.assert_close(half, whole / 2)
    assert loc.grad is not None and not loc.grad[0].any() and loc.grad[1].all()


def test_an_update_is_that_without_a_teacher_if_the_teacher_has_no_action() -> None:
    def learned(teacher: str | None) -> dict[str, torch.Tensor]:
        networks = make_networks()
        algorithm = make(networks, teacher=teacher, target_kl=None)
        batch = collect(networks)
        if teacher is not None:
            algorithm.teacher = lambda given: torch.full_like(given["action"], torch.nan)
        algorithm.update(batch)
        return weights(networks)

    assert same(learned("given here"), learned(None))
