"""The example of learning of one's own: an algorithm, a network with memory, a callback, a logger and a curriculum."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from tiny import BATCH, SILENT, TINY
from torchrl.modules import set_recurrent_mode

from skatemount.agents.switching import SwitchingPolicy
from skatemount.agents.trained_policy import TrainedPolicy
from skatemount.config import compose, compose_program, set_user_config_dir
from skatemount.envs import MountEnv
from skatemount.evaluation.evaluator import Evaluator, deterministic
from skatemount.evaluation.suite_task import EvaluationTask
from skatemount.record import record
from skatemount.rendering.playback import replay_episodes
from skatemount.runs.checkpoint import load_training_state
from skatemount.runs.metrics import read_metrics
from skatemount.training.resume import resume_config
from skatemount.training.trainer import Trainer
from skatemount.utils.errors import ConfigError

pytestmark = pytest.mark.usefixtures("no_pictures")

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "own_learning"
COMMANDS = re.findall(r"^    skatemount train (.+)$", (EXAMPLE / "README.md").read_text(encoding="utf-8"), re.MULTILINE)
SHORT = [*TINY, "episode_length=0.2", "collector.steps_per_env=12"]
"""Episodes of five steps in batches of twelve: most rows of a batch hold the ends of two episodes."""


@pytest.fixture(autouse=True)
def example(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The example's modules and settings."""
    monkeypatch.syspath_prepend(str(EXAMPLE))
    set_user_config_dir(EXAMPLE / "conf")
    yield
    set_user_config_dir(None)


@pytest.fixture
def make(runs_root: Path) -> Iterator[Callable[..., Trainer]]:
    """A trainer, `make(stage, *overrides)`; closed at the end."""
    made: list[Trainer] = []

    def build(stage: str, *overrides: str) -> Trainer:
        made.append(Trainer(compose(stage, [*overrides, f"logger.root={runs_root}"]), list(overrides)))
        return made[-1]

    yield build
    for each in made:
        each.close()


def test_the_readme_names_every_example() -> None:
    modules = {path.stem for path in (EXAMPLE / "own_learning").glob("*.py")} - {"__init__"}
    text = "".join(COMMANDS) + "".join(path.read_text(encoding="utf-8") for path in (EXAMPLE / "conf").rglob("*.yaml"))
    assert modules == set(re.findall(r"own_learning\.(\w+):", text))


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_of_the_readme_trains_and_resumes(
    command: str, make: Callable[..., Trainer], runs_root: Path
) -> None:
    overrides = [word for word in command.replace("--config-dir conf", "").split() if not word.startswith("stage=")]
    stage = re.findall(r"stage=(\w+)", command)[0]
    trainer = make(stage, *overrides, *SHORT, "logger.tensorboard=false", f"total_frames={2 * 3 * BATCH}")
    trainer.train()
    trainer.close()
    given = [f"resume={trainer.run.path}", f"total_frames={3 * 3 * BATCH}"]
    again = Trainer(resume_config(compose(None, given), given), given)
    again.train()
    again.close()
    assert again.frames == 3 * 3 * BATCH
    metrics = read_metrics(trainer.run.metrics_file)
    if "RewardCsv" in command:
        rows = (trainer.run.path / "reward.csv").read_text(encoding="utf-8").splitlines()
        assert [int(row.split(",")[0]) for row in rows] == metrics["frames"].tolist()
    if "Outwards" in command:
        assert (metrics["Curriculum/radius"] >= 0.2).all()
    if "kl" in command:
        state = load_training_state(trainer.run.latest)
        assert (
            float(state["ppo"]["kl_weight"]) == float(again.algorithm.loss.beta) == metrics["Loss/kl_weight"][-1] != 1
        )


def test_patience_ends_a_training(make: Callable[..., Trainer]) -> None:
    from own_learning.callback import Patience

    stopped: list[int] = []
    trainer: Any = SimpleNamespace(stop=lambda: stopped.append(1))
    patience = Patience()
    for rate in (0.1, 0.5, 0.4, 0.5):
        patience.on_evaluation_end(trainer, SimpleNamespace(success_rate=rate))  # type: ignore[arg-type]
    restored = Patience()
    restored.load_state_dict(patience.state_dict())
    assert not stopped
    restored.on_evaluation_end(trainer, SimpleNamespace(success_rate=0.5))  # type: ignore[arg-type]
    assert stopped


def collected(trainer: Trainer) -> Any:
    """Return a batch as the training collects it."""
    batches: list[Any] = []

    def keep(batch: Any) -> dict[str, float]:
        batches.append(batch.clone())
        return {}

    trainer.algorithm.update = keep  # type: ignore[method-assign]
    for _ in trainer.iterations():
        if len(batches) == 2:
            return batches[1]
    raise AssertionError


def test_memory_is_carried_and_reset_the_same_way_in_collection_and_in_whole_sequences(
    make: Callable[..., Trainer],
) -> None:
    trainer = make("balance", "network=gru", *SHORT, *SILENT, "total_frames=1e6")
    batch = collected(trainer)
    begins = batch["is_init"].squeeze(-1)
    # The second batch continues the episodes of the first, and others begin in it.
    assert begins[:, 1:].any() and not begins[:, 0].all()
    assert (batch["memory"][begins] == 0).all() and (batch["memory"][~begins] != 0).any(-1).all()
    with torch.no_grad(), set_recurrent_mode(True):
        actor, _ = trainer.networks.learners()
        log_prob = actor.get_dist(trainer.networks.prepare(batch)).log_prob(batch["action"])
    torch.testing.assert_close(log_prob, batch["action_log_prob"], rtol=1e-4, atol=1e-4)
    # The memory matters: without it the same observations give other actions.
    with torch.no_grad():
        lost = trainer.networks.prepare(batch).set("memory", torch.zeros_like(batch["memory"]))
        assert not torch.allclose(actor.get_dist(lost).mean[~begins], batch["loc"][~begins])


def test_minibatches_hold_whole_sequences(make: Callable[..., Trainer]) -> None:
    updates = ["algorithm.epochs=4", "algorithm.minibatches=4"]
    trainer = make("balance", "network=gru", *SHORT, *updates, *SILENT, "total_frames=1e6")
    shapes: list[tuple[int, ...]] = []
    step = trainer.algorithm._step  # type: ignore[attr-defined]

    def watch(part: Any) -> Any:
        shapes.append(tuple(part.batch_size))
        return step(part)

    trainer.algorithm._step = watch  # type: ignore[attr-defined]
    before = {name: value.clone() for name, value in trainer.networks.named_parameters()}
    next(iter(trainer.iterations()))
    assert shapes == [(2, 12)] * 16  # four epochs of four minibatches
    changed = {name for name, value in trainer.networks.named_parameters() if not torch.equal(before[name], value)}
    assert changed == set(before)


def test_a_restarted_world_forgets_and_the_others_remember(
    make: Callable[..., Trainer], make_env: Callable[..., MountEnv]
) -> None:
    networks = make("balance", "network=gru", *TINY, *SILENT).networks
    env = make_env("balance", num_worlds=3)
    seen: list[torch.Tensor] = []
    networks.gru.register_forward_pre_hook(lambda module, given: seen.append(given[0].get("memory", None)))
    with deterministic():
        state = env.reset()
        act = networks.actor_in(env)
        for i in range(3):
            state = env.step(act(state))["next"]
            if i == 1:
                mask = torch.tensor([[False], [True], [False]])
                state = env.reset(state.set("_reset", mask)).exclude("_reset")
    assert seen[0] is None  # no memory yet, which the GRU takes for zeros
    assert (seen[1] != 0).any(-1).all()
    assert (seen[2] != 0).any(-1).flatten().tolist() == [True, False, True]


def test_a_policy_with_memory_is_saved_evaluated_and_played(make: Callable[..., Trainer], runs_root: Path) -> None:
    trainer = make("balance", "network=gru", *TINY, *SILENT, "total_frames=64")
    trainer.train()
    agent = TrainedPolicy.load(str(trainer.run.path), runs_root)
    assert agent.card.config["network"]["kind"] == "own_learning.gru:GruActorCritic"
    given = [f"checkpoint={trainer.run.path}", "physics.num_worlds=4", "physics.threads=1", "episode_length=1.0"]
    (task,) = EvaluationTask.prepare(compose_program("evaluate", given), given)
    first, second = task.evaluate(8), task.evaluate(8)
    assert torch.equal(first.records.duration, second.records.duration)
    (episode,) = replay_episodes(task, [5])
    assert episode.record.duration == first.records.duration[5]
    pair = SwitchingPolicy(agent.networks, agent.networks, torch.arange(agent.networks.gru.gru.input_size), 0.5)
    evaluator = Evaluator(task.configs[""], num_worlds=4, seed=3)
    alone, switched = (evaluator.round(policy, 0) for policy in (agent.networks, pair))
    evaluator.close()
    assert torch.equal(alone.duration, switched.duration)


@pytest.mark.slow
@pytest.mark.skipif(os.environ.get("MUJOCO_GL") not in ("egl", "osmesa"), reason="needs OpenGL without a display")
def test_a_policy_with_memory_is_filmed(make: Callable[..., Trainer], runs_root: Path) -> None:
    trainer = make("balance", "network=gru", *TINY, *SILENT, "total_frames=64")
    trainer.train()
    given = [f"checkpoint={trainer.run.path}", "episode_length=0.4", "episode=1", "film.width=160", "film.height=120"]
    record(compose_program("record", [*given, "physics.threads=1"]), given)
    (film,) = trainer.run.videos.glob("*.mp4")
    assert film.stat().st_size > 1000


@pytest.mark.parametrize(
    ("overrides", "expected"),
    [
        (
            ["network.params.hiden=8"],
            "network.params.hiden=8: GruActorCritic of own_learning.gru has no such parameter; ",
        ),
        (["network.symmetric=true"], "network.symmetric=true: GruActorCritic of own_learning.gru (network.kind="),
        (
            ["algorithm.minibatches=9"],
            "algorithm.minibatches=9 must be at most the 8 worlds: network.kind=own_learning.",
        ),
        (["algorithm.compile=true"], "algorithm.compile=true: network.kind=own_learning.gru:GruActorCritic cannot be"),
        (
            ["init_from=pretrained:balance"],
            "init_from=pretrained:balance: the policy's network has kind=mlp, this run's",
        ),
        (
            ["init_from=pretrained:balance", "init_from_expand=true"],
            "init_from=pretrained:balance: the policy's network",
        ),
    ],
)
def test_what_does_not_go_together_is_one_line(
    overrides: list[str], expected: str, make: Callable[..., Trainer]
) -> None:
    with pytest.raises(ConfigError) as error:
        make("balance", "network=gru", *TINY, *SILENT, *overrides)
    assert str(error.value).startswith(expected) and "\n" not in str(error.value)


def test_the_page_shows_the_examples(repo_root: Path) -> None:
    page = repo_root / "docs" / "extend_learning.md"
    shown = re.findall(r"^```\{literalinclude\} (\S+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    assert {Path(each).stem for each in shown} >= {"kl", "gru", "callback", "logger", "curriculum"}
    assert all((page.parent / each).is_file() for each in shown)


@pytest.mark.slow
@pytest.mark.nightly
@pytest.mark.parametrize(
    ("choice", "frames"),
    # Success with seed 0: 78.3 % after 277 s of one core, and 77.9 % after 208 s.
    [("algorithm=kl", 900_000), ("network=gru", 589_824)],
)
def test_balance_is_learned_from_scratch(choice: str, frames: int, make: Callable[..., Trainer]) -> None:
    one_core = ["physics.threads=1", "torch_threads=1"]
    result = make(
        "balance", choice, *one_core, f"total_frames={frames}", "logger.evaluate_every=0", "logger.final_episodes=512"
    ).train()
    assert result is not None and result.success_rate >= 0.5
