"""Tests mirror the package: every module has a test file of its own, or a reason why it has none."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

TESTED_IN = {
    "agents/interface.py": "agents/test_trained_policy.py",
    "agents/policy.py": "evaluation/test_evaluator.py",
    "bench.py": "profiling/test_measure.py",
    "cli.py": "test_train_command.py",
    "config/bench.py": "profiling/test_measure.py",
    "config/messages.py": "config/test_compose.py",
    "config/overrides.py": "config/test_keys.py",
    "config/programs.py": "config/test_keys.py",
    "config/report.py": "test_report.py",
    "config/search.py": "searching/test_space.py",
    "config/schema.py": "config/test_compose.py",
    "config/sizes.py": "config/test_refused.py",
    "curriculum/config.py": "curriculum/test_auto.py",
    "envs/config/commands.py": "envs/test_commands.py",
    "envs/config/physics.py": "envs/physics/test_factory.py",
    "envs/config/randomization.py": "envs/test_randomization.py",
    "envs/config/robot.py": "envs/entities/test_quadruped.py",
    "envs/config/sensing.py": "envs/test_sensing.py",
    "envs/config/starts.py": "envs/test_starts.py",
    "envs/config/terms.py": "envs/config/test_task.py",
    "envs/physics/replay.py": "training/test_divergence.py",
    "envs/physics/target_history.py": "envs/test_sensing.py",
    "envs/physics/warp_fields.py": "envs/physics/test_warp.py",
    "envs/robots/a1.py": "envs/entities/test_quadruped.py",
    "envs/robots/shapes.py": "envs/robots/test_reader.py",
    "envs/robots/writer.py": "test_robot_spec.py",
    "envs/entities/a1_visuals.py": "envs/entities/test_primitive_visuals.py",
    "envs/entities/go2_visuals.py": "envs/entities/test_primitive_visuals.py",
    "envs/mdp.py": "envs/test_task.py",
    "envs/rewards/board.py": "envs/rewards/test_terms.py",
    "envs/rewards/locomotion.py": "envs/rewards/test_terms.py",
    "envs/tasks/gait.py": "envs/test_success.py",
    "envs/tasks/mount_and_ride.py": "envs/tasks/test_ride.py",
    "envs/tasks/metrics.py": "envs/tasks/test_measures.py",
    "envs/tasks/mount.py": "envs/test_success.py",
    "envs/state.py": "envs/physics/test_cpu.py",
    "evaluation/report.py": "evaluation/test_results.py",
    "losses/base.py": "examples/test_own_learning.py",
    "losses/config.py": "losses/test_ppo.py",
    "losses/finite.py": "losses/test_ppo.py",
    "losses/imitation.py": "agents/test_teacher.py",
    "exporting/folder.py": "runner/test_folder.py",
    "exporting/starts.py": "runner/test_simulation.py",
    "exporting/vectors.py": "runner/test_folder.py",
    "exporting/world.py": "runner/test_simulation.py",
    "models/base.py": "examples/test_own_learning.py",
    "models/config.py": "models/test_actor_critic.py",
    "profiling/report.py": "profiling/test_measure.py",
    "profiling/workload.py": "profiling/test_measure.py",
    "replay_diverged.py": "training/test_divergence.py",
    "reports/curves.py": "reports/test_run_page.py",
    "reports/facts.py": "reports/test_run_page.py",
    "reports/page.py": "reports/test_run_page.py",
    "runner/simulated_robot.py": "runner/test_hardware.py",
    "runs/atomic.py": "runs/test_checkpoint.py",
    "runs/find.py": "runs/test_folder.py",
    "runs/locks.py": "searching/test_folder.py",
    "runs/metrics.py": "runs/test_loggers.py",
    "runs/old_state.py": "training/test_trainer.py",
    "runs/provenance.py": "runs/test_folder.py",
    "runs/serialization.py": "runs/test_checkpoint.py",
    "runs/shipped.py": "config/test_versions.py",
    "searching/best.py": "searching/test_results.py",
    "searching/picture.py": "searching/test_results.py",
    "searching/worker.py": "test_search.py",
    "train.py": "test_train_command.py",
    "viewer/scene.py": "viewer/test_page.py",
    "viewer/texts.py": "viewer/test_poses.py",
    "training/collecting.py": "training/test_exact_resume.py",
    "training/follower.py": "training/test_distributed.py",
    "training/resume.py": "training/test_trainer.py",
    "training/score.py": "test_multirun.py",
    "training/setup.py": "training/test_trainer.py",
    "training/state.py": "training/test_trainer.py",
    "training/trainer_state.py": "training/test_exact_resume.py",
    "utils/cores.py": "utils/test_devices.py",
}
"""Modules that are part of what another module's tests are about, and that test file."""


def modules() -> set[str]:
    files = (ROOT / "skatemount").rglob("*.py")
    return {str(path.relative_to(ROOT / "skatemount")) for path in files if not path.name.startswith("__")}


def own_test(module: str) -> Path:
    path = Path(module)
    return ROOT / "tests" / path.parent / f"test_{path.name}"


def test_every_module_has_a_test_of_its_own_or_a_reason() -> None:
    assert {module for module in modules() if not own_test(module).is_file()} == set(TESTED_IN)


def test_the_reasons_name_tests_that_exist() -> None:
    assert [test for test in TESTED_IN.values() if not (ROOT / "tests" / test).is_file()] == []
