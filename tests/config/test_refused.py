"""Nonsense is refused in one line that names the setting: tables of inputs, by kind."""

from __future__ import annotations

import copy
import functools
import math
from typing import Any

import pytest
from composed import one_line, stage_config

from skatemount.config import TrainConfig, compose_program, from_dict, to_dict
from skatemount.config.sizes import check_sizes
from skatemount.config.suite import SuiteConfig
from skatemount.envs.config.task import TaskConfig
from skatemount.utils.errors import ConfigError

INF, NAN = math.inf, math.nan

# Smallest and largest refused value of each number; nan, inf, -inf, text and null are refused everywhere.
NUMBERS: dict[str, tuple[float, float]] = {
    "episode_length": (0, 3601),
    "seed": (-1, 2**62 + 1),
    "total_frames": (0, 10**13),
    "torch_threads": (-1, 2000),
    "robot.kp": (0, 1e30),
    "robot.kd": (-0.1, 1e9),
    "robot.torque_limit": (-5, 1e9),
    "robot.speed_limit": (0, 1e9),
    "robot.action_scale_hip": (-0.1, 1e3),
    "robot.action_scale_thigh": (-0.1, 1e3),
    "robot.action_scale_calf": (-0.1, 1e3),
    "robot.action_clip": (0, 1e30),
    "robot.joint_friction": (-1, 1e6),
    "robot.joint_damping": (-1, 1e6),
    "robot.armature": (-0.01, 1e6),
    "robot.foot_friction": (-0.8, 1e6),
    "board.deck_length": (0, 1000),
    "board.deck_width": (0, 1000),
    "board.deck_thickness": (0, 5),
    "board.deck_height": (-0.1, 50),
    "board.mass": (-2, 1e6),
    "board.truck_mass": (0, 1e6),
    "board.wheel_mass": (0, 1e6),
    "board.wheelbase": (1e-6, 1000),
    "board.track": (1e-6, 1000),
    "board.wheel_radius": (1e-6, 10),
    "board.wheel_width": (1e-9, 10),
    "board.truck_angle": (4, 86),
    "board.truck_stiffness": (-1, 1e9),
    "board.truck_damping": (-1, 1e9),
    "board.truck_limit": (0, 60),
    "board.truck_armature": (-1, 1e6),
    "board.wheel_stiffness": (-1, 1e9),
    "board.wheel_damping": (-1, 1e9),
    "board.wheel_friction": (-1, 1e9),
    "board.wheel_armature": (-1, 1e6),
    "board.wheel_grip": (-1, 1e6),
    "board.deck_friction": (-1, 1e6),
    "board.kick_length": (-0.1, 100),
    "board.kick_angle": (-1, 60),
    "physics.timestep": (0, 0.1),
    "physics.substeps": (0, 100_000_000),
    "physics.iterations": (0, 10**9),
    "physics.ls_iterations": (0, 10**9),
    "physics.tolerance": (-1e-9, 2),
    "physics.impratio": (0, 1e6),
    "physics.num_worlds": (0, 1_000_000_000),
    "physics.threads": (-1, 5000),
    "physics.max_contacts": (0, 10**9),
    "physics.max_constraints": (0, 10**9),
    "command.resample": (0, 1e9),
    "command.standing": (-0.1, 1.1),
    "command.deadband": (-0.1, 1e3),
    "start.board_fixed": (-0.1, 1.1),
    "start.edge_margin": (-0.1, 50),
    "observation.history_length": (0, 10**6),
    "network.init_std": (0, 1e9),
    "network.min_std": (-1, 1e9),
    "network.max_std": (0, 1e9),
    "algorithm.epochs": (0, 10**9),
    "algorithm.minibatches": (0, 10**9),
    "algorithm.learning_rate": (0, 1e9),
    "algorithm.min_learning_rate": (0, 1e9),
    "algorithm.max_learning_rate": (-1, 1e9),
    "algorithm.clip_epsilon": (0, 1e9),
    "algorithm.critic_coeff": (-1, 1e9),
    "algorithm.entropy_coeff": (-1, 1e9),
    "algorithm.discount_horizon": (0, 1e9),
    "algorithm.gae_horizon": (0, 1e9),
    "algorithm.max_grad_norm": (0, 1e30),
    "algorithm.std_frames": (0, 10**15),
    "algorithm.kl_anneal_fraction": (0, 1.1),
    "collector.steps_per_env": (0, 10**9),
    "curriculum.min_height": (0, 5),
    "curriculum.success_threshold": (0, 1),
    "curriculum.solved_rate": (0, 1),
    "curriculum.window": (0, 1e12),
    "curriculum.min_episodes": (0, 1e12),
    "curriculum.replay_fraction": (0, 1),
    "curriculum.stage_range_fraction": (-0.1, 1.1),
    "curriculum.stuck_start_fraction": (-0.1, 1),
    "logger.progress_every": (-1, 1e12),
    "logger.plot_every": (-1, 1e12),
    "logger.checkpoint_every": (0, 10**12),
    "logger.keep_checkpoints": (0, 10**12),
    "logger.evaluate_every": (-1, 10**12),
    "logger.evaluate_episodes": (0, 10**12),
    "logger.final_episodes": (-1, 10**12),
}

# A refused range below, and one above.
RANGES: dict[str, tuple[list[float], list[float]]] = {
    "start.x": ([-1e6, 0], [0, 1e6]),
    "start.y": ([-1e6, 0], [0, 1e6]),
    "start.distance": ([-1, 1], [0, 1e6]),
    "start.yaw": ([-1e6, 0], [0, 1e6]),
    "start.roll": ([-0.6, 0], [0, 0.6]),
    "start.pitch": ([-0.6, 0], [0, 0.6]),
    "start.height": ([-0.1, 0], [0, 100]),
    "start.lin_vel": ([-1e3, 0], [0, 1e3]),
    "start.ang_vel": ([-1e3, 0], [0, 1e3]),
    "start.joint_pos": ([-10, 0], [0, 10]),
    "start.joint_vel": ([-1e6, 0], [0, 1e6]),
    "start.step_height": ([-5, 0], [0, 5]),
    "start.board_speed": ([-1, 0], [0, 1e3]),
    "start.force": ([-1e9, 0], [0, 1e9]),
    "start.torque": ([-1e9, 0], [0, 1e9]),
    "command.forward": ([-1e3, 0], [0, 1e3]),
    "command.left": ([-1e3, 0], [0, 1e3]),
    "command.turn": ([-1e3, 0], [0, 1e3]),
    "randomization.friction": ([0, 1], [1, 1e6]),
    "randomization.trunk_mass": ([-1e3, 0], [0, 1e3]),
    "randomization.trunk_com": ([-10, 0], [0, 10]),
    "randomization.inertia": ([0, 1], [1, 1e6]),
    "randomization.board_mass": ([-1, 1], [1, 1e6]),
    "randomization.truck_stiffness": ([-1, 1], [1, 1e6]),
    "randomization.kp": ([0, 1], [1, 1e6]),
    "randomization.kd": ([0, 1], [1, 1e6]),
    "randomization.push_interval": ([0, 1], [1, 1e6]),
    "randomization.push_velocity": ([-1e3, 0], [0, 1e3]),
}

MAY_BE_NULL = {"start.distance", "start.step_height", "randomization.push_interval"}

CHOICES: list[tuple[str, Any, str]] = [
    ("success", "win", "gait, hold, mount"),
    ("precision", "low", "highest, medium, bf16"),
    ("robot.variant", "b1", "unitree, isaac"),
    ("physics.engine", "warm", "cpu, warp"),
    ("physics.solver", "Gauss", "Newton, CG, PGS"),
    ("physics.cone", "round", "pyramidal, elliptic"),
    ("physics.device", "gpu", "auto, cpu, cuda"),
    ("physics.device", "cuda:", "cuda:<number>"),
    ("command.mode", "follow", "sampled, board, zero"),
    ("command.turn_to", "left", "nearer, front"),
    ("network.activation", "gelu", "elu, relu, tanh, silu"),
    ("curriculum.kind", "automatic", "none, stages, auto"),
]

TABLES: list[tuple[str, Any, str]] = [
    ("reward", {}, "reward={} must have at least one term"),
    ("termination", {}, "termination={} must have at least one term"),
    ("observation.policy", {}, "observation.policy={} must have at least one term"),
    ("observation.privileged", {}, "observation.privileged={} must have at least one term"),
]

ROWS: list[tuple[str, Any, str]] = [
    ("reward.alive.weight", -0.1, "give the size"),
    ("reward.alive.weight", 1e30, "from 0 to 1e+06"),
    ("reward.alive.weight", INF, "from 0"),
    ("reward.alive.weight", NAN, "from 0"),
    ("reward.alive.clip", 0.0, "above 0"),
    ("reward.alive.clip", -1.0, "above 0"),
    ("reward.alive.clip", INF, "above 0"),
    ("observation.policy.gravity.scale", INF, "from -1e+06"),
    ("observation.policy.gravity.scale", 1e30, "from -1e+06"),
    ("observation.policy.gravity.noise", -1.0, "from 0"),
    ("observation.policy.gravity.noise", NAN, "from 0"),
    ("observation.policy.gravity.clip", 0.0, "above 0"),
    ("observation.policy.gravity.history_length", 0, "from 1 to 100"),
    ("observation.policy.gravity.history_length", 10**9, "from 1 to 100"),
    ("observation.privileged.heights.history_length", 2, "must be null"),
]

PARAMETERS: list[tuple[str, str, Any, str]] = [
    ("termination", "tilt.degrees", -5, "above 0 and at most 180 degrees"),
    ("termination", "tilt.degrees", 181, "above 0 and at most 180 degrees"),
    ("termination", "board_tilt.degrees", 0, "above 0 and at most 180 degrees"),
    ("termination", "board_tilt.degrees", NAN, "finite"),
    ("termination", "out_of_reach.metres", -1, "above 0"),
    ("termination", "out_of_reach.metres", 1e9, "at most 1000 m"),
    ("termination", "out_of_reach.metres", "far", "type float"),
    ("termination", "out_of_reach.meters", 2, "not a parameter"),
    ("reward", "distance.scale", 0, "above 0"),
    ("reward", "distance.scale", -1, "above 0"),
    ("reward", "feet_proximity.scale", INF, "finite"),
    ("reward", "approach.limit", -1, "above 0"),
    ("reward", "alignment.gate", -0.3, "above 0"),
    ("reward", "mounted.ramp", -1, "from 0"),
    ("reward", "joint_pose_squared.when_mounted", -10, "from 0"),
    ("reward", "track_lin_vel.sigma", 0, "above 0"),
    ("reward", "board_speed.horizontal", 7, "type bool"),
    ("observation.policy", "outline.points", 0, "from 1 to 256"),
    ("observation.policy", "outline.points", 10**9, "from 1 to 256"),
    ("observation.policy", "outline.points", 1.5, "type int"),
]

TOGETHER: list[tuple[dict[str, Any], str]] = [
    ({"episode_length": 0.01}, "at least a control step"),
    ({"board.mass": 0.2}, "board.mass=0.2 must be more than"),
    ({"board.wheelbase": 0.6}, "at most deck_length"),
    ({"board.wheelbase": 0.04}, "wheels would overlap"),
    ({"board.track": 0.03}, "greater than wheel_width"),
    ({"board.deck_height": 0.06}, "hit its wheels"),
    ({"board.deck_color": [0.5, 0.5]}, "three numbers"),
    ({"start.board_speed": [0.0, 0.5]}, "needs free boards"),
    ({"robot.thigh": 9.0}, "robot.thigh=9.0 must be from"),
    ({"robot.calf": 0.0}, "robot.calf=0.0 must be from"),
    ({"robot.hip_inward": -3.0}, "robot.hip_inward=-3.0 must be from"),
    (
        {"robot.action_scale_hip": 0.0, "robot.action_scale_thigh": 0.0, "robot.action_scale_calf": 0.0},
        "no action would move the robot",
    ),
    ({"algorithm.min_learning_rate": 0.01}, "max_learning_rate"),
    ({"algorithm.learning_rate": 0.009}, "max_learning_rate"),
    ({"algorithm.final_target_kl": 0.5}, "algorithm.target_kl"),
    ({"algorithm.final_target_kl": 0.5, "algorithm.target_kl": None}, "needs algorithm.target_kl"),
    ({"algorithm.final_std": 5.0}, "network.max_std"),
    ({"algorithm.minibatches": 90_000}, "steps of a batch"),
    ({"network.init_std": 0.01}, "min_std <= init_std"),
    ({"collector.max_mounted_time": 0.5}, "a success takes that much standing"),
    ({"curriculum.min_height": 0.05}, "heights[0]"),
    ({"curriculum.min_episodes": 50}, "at most window"),
    ({"curriculum.stage_range_from": 0.01}, "some bins must be left"),
    ({"curriculum.kind": "stages"}, "curriculum=paper"),
    ({"stage.gate": 0.9, "logger.evaluate_every": 0}, "needs evaluations"),
    ({"stage.gate": 1.5}, "stage.gate=1.5"),
    ({"logger.root": ""}, "must name a folder"),
]

LAYERS: list[tuple[str, Any, str]] = [
    ("network.actor", [], "layer sizes"),
    ("network.critic", [], "layer sizes"),
    ("network.actor", [0], "each from 1"),
    ("network.actor", [-64, 64], "each from 1"),
    ("network.actor", [64, 33], "even"),
    ("network.actor", [100_000_000, 100_000_000], "each from 1 to 16384"),
    ("network.critic", [16_384, 16_384], "weights between its layers"),
    ("network.critic", [64] * 1000, "1 to 32 layer sizes"),
    ("network.actor", "wide", "list of numbers"),
    ("network.actor", [64.5], ""),
]

EDGES: list[tuple[str, Any, str]] = [
    ("curriculum.distances", [], "increasing"),
    ("curriculum.distances", [0.2, 0.1], "increasing"),
    ("curriculum.distances", [0.1, 0.1], "increasing"),
    ("curriculum.distances", [-1.0, 0.1], "above 0"),
    ("curriculum.distances", [0.1, INF], "above 0"),
    ("curriculum.bearings", [30.0, 120.0], "a board has no front"),
    ("curriculum.headings", [0.0, 90.0], "above 0"),
    ("curriculum.heights", [0.02, 5.0], "at most 1 m"),
    ("curriculum.heights", [NAN], "above 0"),
    ("curriculum.distances", [0.01 * i for i in range(1, 500)], "at most 100"),
]

NAMES: list[tuple[str, Any, str]] = [
    ("stage.name", "/../../../X", "leading dot"),
    ("stage.name", "..", "leading dot"),
    ("stage.name", "a/b", "leading dot"),
    ("stage.name", "a\\b", "leading dot"),
    ("stage.name", "C:x", "leading dot"),
    ("stage.name", "a\nb", "leading dot"),
    ("stage.name", "x" * 101, "100 characters"),
]

SIZES: list[tuple[dict[str, Any], str]] = [  # on a machine of 2 GB and two cores
    ({"physics.num_worlds": 1_000_000}, "physics.num_worlds=1000000: the training would take about"),
    ({"collector.steps_per_env": 50_000}, "collector.steps_per_env=50000: the training would take about"),
    ({"network.symmetric": False, "network.actor": [11_000] * 2}, "GB"),
    ({"physics.substeps": 1000, "physics.timestep": 1e-4, "collector.steps_per_env": 150}, "hours on 2 cores"),
    ({"logger.final_episodes": 1_000_000, "episode_length": 3600.0}, "logger.final_episodes=1000000"),
    ({"logger.evaluate_episodes": 1_000_000, "episode_length": 3600.0}, "logger.evaluate_episodes=1000000"),
]

SUITES: list[tuple[dict[str, Any], str]] = [
    ({"name": ""}, "suite.name=''"),
    ({"name": "/../x"}, "suite.name='/../x'"),
    ({"name": ".hidden"}, "suite.name='.hidden'"),
    ({"version": 0}, "suite.version=0"),
    ({"version": 10**9}, "suite.version=1000000000"),
    ({"seed": -1}, "suite.seed=-1"),
    ({"seed": 2**63}, "suite.seed="),
    ({"stage": ""}, "one of the two"),
    ({"members": ["gait"]}, "one of the two"),
    ({"stage": "", "members": ["gait"], "overrides": ["seed=1"]}, "no overrides"),
]

SAVED: list[tuple[dict[str, Any], str]] = [
    ({"format": 0}, "format=0"),
    ({"format": "2"}, "format='2'"),
    ({"format": 99}, "newer"),
    ({"seed": "x"}, "seed=x must be a whole number"),
    ({"seed": None}, "seed=null"),
    ({"seed": "${oc.env:HOME}"}, "seed"),
    ({"seed": "${nosuch}"}, "nosuch"),
    ({"nosuch": 1}, "nosuch=1"),
    ({"robot": 5}, "robot"),
    ({"robot": None}, "robot"),
    ({"network": {"actor": "x"}}, "network.actor=x"),
    ({"plugins": ["os;system"]}, "plugins=[os;system]"),
    ({"plugins": ["no_such_module_here"]}, "plugins=[no_such_module_here]"),
    ({"stage": {"name": "/../X"}}, "stage.name='/../X'"),
    ({"reward": {}}, "reward={}"),
    ({"termination": [1]}, "termination"),
]


def _train() -> TrainConfig:
    return copy.deepcopy(stage_config("balance"))


def _set(config: TaskConfig, key: str, value: Any) -> None:
    part: Any = config
    *path, name = key.split(".")
    for each in path:
        part = part[each] if isinstance(part, dict) else getattr(part, each)
    setattr(part, name, value)


def _message(action: Any, *arguments: Any) -> str:
    with pytest.raises(ConfigError) as error:
        action(*arguments)
    return one_line(error)


def _numbers() -> list[tuple[str, str, Any]]:
    cases = []
    for key, (low, high) in NUMBERS.items():
        kinds = {"below": low, "above": high, "nan": NAN, "infinite": -INF, "text": "many", "null": None}
        cases += [(kind, key, value) for kind, value in kinds.items()]
    for key, (below, above) in RANGES.items():
        kinds = {
            "range below": below,
            "range above": above,
            "range reversed": below[::-1],
            "range of nan": [NAN, NAN],
            "range of three": [*below, 1.0],
        }
        cases += [(kind, key, value) for kind, value in kinds.items()]
        if key not in MAY_BE_NULL:
            cases.append(("null", key, None))
    return cases


@pytest.mark.parametrize("kind", sorted({kind for kind, _, _ in _numbers()}))
def test_numbers(kind: str) -> None:
    for case, key, value in _numbers():
        if case == kind:
            config = _train()
            _set(config, key, value)
            text = _message(config.validate)
            # A contradiction may name its other setting first.
            assert key in text or key.split(".")[-1] in text, text
            assert str(value) in text or kind == "null", text


LISTED = {
    "choices": CHOICES,
    "empty tables": TABLES,
    "rows of tables": ROWS,
    "layers": LAYERS,
    "edges of bins": EDGES,
    "names": NAMES,
}


def _validate(config: TrainConfig) -> None:
    config.validate()
    # Names of tasks and terms need torch, so they are checked apart.
    config.validate_terms()


@pytest.mark.parametrize("kind", LISTED)
def test_single_settings(kind: str) -> None:
    for key, value, expected in LISTED[kind]:
        config = _train()
        _set(config, key, value)
        text = _message(lambda config=config: _validate(config))
        assert key in text and expected in text, text


def test_parameters_of_terms() -> None:
    for table, name, value, expected in PARAMETERS:
        config = _train()
        term, parameter = name.split(".")
        rows = functools.reduce(getattr, table.split("."), config)
        rows[term].params = {**rows[term].params, parameter: value}
        text = _message(config.validate_terms)
        assert f"{table}.{term}.params.{parameter}" in text and expected in text, text


def test_settings_that_contradict_each_other() -> None:
    for changes, expected in TOGETHER:
        config = _train()
        for key, value in changes.items():
            _set(config, key, value)
        text = _message(config.validate)
        assert expected in text, text


def test_a_training_that_the_machine_cannot_do() -> None:
    for changes, expected in SIZES:
        config = _train()
        for key, value in changes.items():
            _set(config, key, value)
        config.validate()
        text = _message(functools.partial(check_sizes, memory=2 * 10**9, cores=2), config)
        assert expected in text, text


def test_suites() -> None:
    for changes, expected in SUITES:
        values = {"name": "mine", "stage": "mount"} | changes
        assert expected in _message(SuiteConfig(**values).validate)


def test_saved_settings() -> None:
    saved = to_dict(_train())
    for changes, expected in SAVED:
        values = copy.deepcopy(saved)
        for key, value in changes.items():
            values[key] = {**values[key], **value} if isinstance(value, dict) and value else value
        text = _message(from_dict, values)
        assert expected in text and text.startswith("saved settings: "), text


PROGRAMS: list[tuple[str, str, str]] = [
    ("evaluate", "episodes=0", "episodes=0"),
    ("evaluate", "episodes=1e12", "episodes=1000000000000"),
    ("evaluate", "episodes=999999 episode_length=3600", "episodes=999999: episodes of episode_length=3600"),
    ("evaluate", "switch_distance=-1", "switch_distance=-1"),
    ("evaluate", "seed=-1", "seed=-1"),
    ("record", "film.width=641", "an even number"),
    ("record", "film.width=100000", "from 160 to 3840"),
    ("record", "film.height=0", "from 120 to 2160"),
    ("record", "film.speed=0", "0.5 plays at half speed"),
    ("record", "film.camera=left", "follow, side, top, fixed"),
    ("record", "episode=-1", "episode=-1"),
    ("record", "episode_length=3600 film.width=3840 film.height=2160", "pixels"),
    ("bench", "bench.rounds=0", "bench.rounds=0"),
    ("bench", "bench.seconds=inf", "bench.seconds=inf"),
    ("bench", "bench.worlds=[0]", "bench.worlds=[0]"),
    ("bench", "bench.threads=[-1]", "bench.threads=[-1]"),
    ("train", "+stage=balance total_frame=5", "total_frame"),
    ("train", "+stage=balance physics.num_worlds=many", "physics.num_worlds=many must be a whole number"),
    ("train", "+stage=balance seed=${nosuch}", "nosuch"),
]


def test_the_programs() -> None:
    for program, words, expected in PROGRAMS:
        text = _message(compose_program, program, words.split())
        assert expected in text, text


def test_there_are_enough_of_them() -> None:
    counts = {kind: sum(case == kind for case, _, _ in _numbers()) for kind, _, _ in _numbers()}
    counts |= {kind: len(cases) for kind, cases in LISTED.items()}
    for cases in (PARAMETERS, TOGETHER, SIZES, SUITES, SAVED, PROGRAMS):
        counts[str(len(counts))] = len(cases)  # type: ignore[arg-type]
    assert sum(counts.values()) >= 400 and all(counts.values())
