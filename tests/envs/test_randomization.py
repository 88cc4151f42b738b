from __future__ import annotations

import functools
import math

import defaults
import mujoco
import numpy as np
import pytest
import torch
from torch import Tensor

from skatemount.envs.entities.quadruped import KD_INDEX, KP_INDEX, RESISTANCE_INDEX
from skatemount.envs.randomization import Pushes, Randomizer
from skatemount.envs.scene import Scene, SceneIndex
from skatemount.utils.errors import ConfigError

WORLDS = 400


@functools.cache
def compiled() -> tuple[mujoco.MjModel, SceneIndex]:
    scene = Scene(defaults.robot(), defaults.board(), defaults.physics())
    model = scene.compile(visuals=False)
    return model, SceneIndex.of(scene, model)


class Fields:
    """Model fields of many worlds without an engine."""

    def __init__(self, worlds: int = WORLDS):
        self.model, self.index = compiled()
        self.fields: dict[str, Tensor] = {}
        self.refreshed = 0
        self._worlds = worlds

    def field(self, name: str) -> Tensor:
        if name not in self.fields:
            nominal = torch.from_numpy(np.array(getattr(self.model, name)))
            self.fields[name] = nominal.expand(self._worlds, *nominal.shape).clone()
        return self.fields[name]

    def refresh_constants(self) -> None:
        self.refreshed += 1

    def ratio(self, name: str) -> Tensor:
        """Values over the nominal ones."""
        nominal = torch.from_numpy(np.array(getattr(self.model, name)))
        return self.field(name) / nominal

    def added(self, name: str) -> Tensor:
        return self.field(name) - torch.from_numpy(np.array(getattr(self.model, name)))


def build(seed: int = 0, fields: Fields | None = None, **ranges: list[float]) -> tuple[Fields, Randomizer]:
    fields = fields or Fields()
    generator = torch.Generator().manual_seed(seed)
    randomizer = Randomizer(defaults.randomization(**ranges), fields.index, fields.model, generator)
    randomizer.build_worlds(fields)
    return fields, randomizer


def assert_fills(values: Tensor, low: float, high: float) -> None:
    assert values.min() >= low - 1e-9 and values.max() <= high + 1e-9
    assert values.max() - values.min() > 0.95 * (high - low)


def everywhere() -> Tensor:
    return torch.arange(WORLDS)


def test_dynamics_are_the_physics_that_was_drawn() -> None:
    wide = [0.5, 2.0]
    motors = {"kp": wide, "kd": wide, "torque_limit": wide}
    fields, randomizer = build(friction=wide, trunk_mass=[-1.0, 3.0], board_mass=wide, truck_stiffness=wide, **motors)
    randomizer.new_episodes(fields, everywhere())
    rows = torch.tensor([7, 3, 390])
    friction, trunk, deck, trucks, kp, kd, limit, delay = randomizer.dynamics(fields, rows).T
    index, motor = fields.index, fields.index.actuators[-1]
    expected = {
        "friction": (friction, fields.ratio("geom_friction")[rows, index.touched_geoms[-1], 0]),
        "trunk": (trunk, fields.added("body_mass")[rows, index.trunk_body]),
        "deck": (deck, fields.field("body_mass")[rows, index.board_body]),
        "trucks": (trucks, fields.field("jnt_stiffness")[rows, index.truck_joints[-1]]),
        "kp": (kp, fields.ratio("actuator_gainprm")[rows, motor, KP_INDEX]),
        "limit": (limit, fields.ratio("actuator_forcerange")[rows, motor, 1]),
    }
    for name, (found, drawn) in expected.items():
        torch.testing.assert_close(found, drawn.float(), msg=name)
        assert len(found.unique()) == 3, name
    assert len(kd.unique()) == 3 and not torch.equal(kd, kp) and (delay == 0).all()


def test_dynamics_of_nominal_worlds_give_no_world_fields_of_its_own() -> None:
    fields, randomizer = build()
    found = randomizer.dynamics(fields, torch.arange(2))
    model, index = fields.model, fields.index
    deck, trucks = model.body_mass[index.board_body], model.jnt_stiffness[index.truck_joints[0]]
    nominal = torch.tensor([1.0, 0.0, float(deck), float(trucks), 1.0, 1.0, 1.0, 0.0])
    torch.testing.assert_close(found, nominal.repeat(2, 1))
    assert not fields.fields


def test_the_critic_sees_the_physics_of_each_world(make_env) -> None:
    settings = ["observation=student", "boards=varied", "randomization=robust", "sensing=default", "episode_length=0.4"]
    env = make_env("unfixed", 6, settings)
    td = env.reset()
    for _ in range(15):  # worlds begin their second episode
        field, motor = env.physics.field, env.physics.index.actuators[0]
        _, td = env.step_and_maybe_reset(td.set("action", torch.zeros(env.action_spec.shape)))
        shown = env.episode.dynamics
        start = sum(each["size"] for each in env.mdp.privileged.layout()[:-1])
        assert env.mdp.privileged.layout()[-1]["name"] == "dynamics"
        assert torch.equal(td["privileged"][:, start:], shown)
        torch.testing.assert_close(shown[:, 2], field("body_mass")[:, env.physics.index.board_body].float())
        torch.testing.assert_close(shown[:, 7], field("actuator_delay")[:, motor].float())
    assert all(len(column.unique()) > 1 for column in shown.T)


def test_a_state_from_before_dynamics_were_kept_can_be_restored(make_env) -> None:
    settings = ["observation=student", "boards=varied", "randomization=robust", "episode_length=0.4"]
    saved, restored = (make_env("unfixed", 4, settings, seed=3) for _ in range(2))
    saved.reset()
    state = saved.world_state()
    del state["episode"]["dynamics"]
    restored.load_world_state(state)
    td = restored.reset()
    assert not restored.episode.dynamics.any() and torch.equal(restored.episode.step, saved.episode.step)
    for _ in range(11):  # the next episodes have them
        _, td = restored.step_and_maybe_reset(td.set("action", torch.zeros(restored.action_spec.shape)))
    assert restored.episode.dynamics.all(0).sum() >= 7  # all but the delay


def test_without_ranges_nothing_is_touched() -> None:
    fields, randomizer = build()
    randomizer.new_episodes(fields, everywhere())
    assert not fields.fields and not fields.refreshed


def test_friction_is_one_factor_for_all_that_the_robot_touches() -> None:
    fields, _ = build(friction=[0.5, 1.5])
    ratio = fields.ratio("geom_friction")
    touched = ratio[:, fields.index.touched_geoms, 0]
    assert_fills(touched[:, 0], 0.5, 1.5)
    torch.testing.assert_close(touched, touched[:, :1].expand_as(touched))
    others = np.setdiff1d(np.arange(fields.model.ngeom), fields.index.touched_geoms)
    assert len(others) >= 5  # the wheels and their floor
    assert (ratio[:, others, 0] == 1).all() and (ratio[..., 1:] == 1).all()
    assert not fields.refreshed


def test_the_deck_and_the_robots_floor_are_among_what_it_touches() -> None:
    model, index = compiled()
    names = {model.geom(i).name for i in index.touched_geoms}
    assert {"board/deck", "robot_ground", "a1/FR_foot", "a1/RL_foot"} <= names
    assert not any("wheel" in name for name in names)


def test_trunk_mass_is_added() -> None:
    fields, _ = build(trunk_mass=[-1.0, 2.0])
    added = fields.added("body_mass")
    assert_fills(added[:, fields.index.trunk_body], -1.0, 2.0)
    added[:, fields.index.trunk_body] = 0
    assert (added == 0).all()
    assert fields.refreshed == 1


def test_a_trunk_keeps_a_mass_above_nothing() -> None:
    fields, _ = build(trunk_mass=[-50.0, -50.0])
    assert (fields.field("body_mass")[:, fields.index.trunk_body] > 0).all()


def test_the_boards_mass_and_inertia_share_a_factor() -> None:
    fields, _ = build(board_mass=[0.5, 2.0])
    deck = fields.index.board_body
    mass, inertia = fields.ratio("body_mass")[:, deck], fields.ratio("body_inertia")[:, deck]
    assert_fills(mass, 0.5, 2.0)
    torch.testing.assert_close(inertia, mass.unsqueeze(1).expand(-1, 3))
    others = np.delete(np.arange(fields.model.nbody), deck)
    assert (fields.added("body_mass")[:, others] == 0).all()


def test_inertia_has_a_factor_for_each_robot_body() -> None:
    fields, _ = build(inertia=[0.8, 1.3])
    bodies = fields.index.robot_bodies
    ratio = fields.ratio("body_inertia")[:, bodies]
    assert_fills(ratio, 0.8, 1.3)
    torch.testing.assert_close(ratio, ratio[..., :1].expand_as(ratio))
    assert (ratio[:, 0, 0] != ratio[:, 1, 0]).all()
    others = np.setdiff1d(np.arange(fields.model.nbody), bodies)
    assert (fields.added("body_inertia")[:, others] == 0).all()


def test_board_mass_and_inertia_can_be_drawn_together() -> None:
    fields, _ = build(board_mass=[2.0, 2.0], inertia=[3.0, 3.0])
    ratio = fields.ratio("body_inertia")
    torch.testing.assert_close(ratio[:, fields.index.board_body], torch.full((WORLDS, 3), 2.0, dtype=torch.float64))
    torch.testing.assert_close(ratio[:, fields.index.trunk_body], torch.full((WORLDS, 3), 3.0, dtype=torch.float64))


def test_the_center_of_mass_moves_along_each_axis() -> None:
    fields, _ = build(trunk_com=[-0.02, 0.03])
    added = fields.added("body_ipos")
    moved = added[:, fields.index.trunk_body].clone()
    for axis in range(3):
        assert_fills(moved[:, axis], -0.02, 0.03)
    assert np.corrcoef(moved.T)[0, 1] == pytest.approx(0, abs=0.2)
    added[:, fields.index.trunk_body] = 0
    assert (added == 0).all() and fields.refreshed == 1


def test_both_trucks_share_a_factor() -> None:
    fields, _ = build(truck_stiffness=[0.8, 1.25])
    stiffness = fields.field("jnt_stiffness")[:, fields.index.truck_joints]
    ratio = stiffness / torch.from_numpy(fields.model.jnt_stiffness[fields.index.truck_joints])
    assert_fills(ratio[:, 0], 0.8, 1.25)
    torch.testing.assert_close(ratio[:, 0], ratio[:, 1])
    fields.field("jnt_stiffness")[:, fields.index.truck_joints] -= stiffness
    untouched = np.delete(np.arange(fields.model.njnt), fields.index.truck_joints)
    assert (fields.added("jnt_stiffness")[:, untouched] == 0).all()


def test_gains_are_drawn_log_uniformly_for_the_whole_robot() -> None:
    fields, randomizer = build(kp=[0.5, 2.0], kd=[0.9, 1.2])
    assert not fields.fields  # not before the first episode
    randomizer.new_episodes(fields, everywhere())
    ratio = fields.ratio("actuator_gainprm")
    kp, kd = ratio[..., KP_INDEX], ratio[..., KD_INDEX]
    assert_fills(kp, 0.5, 2.0)
    assert_fills(kd, 0.9, 1.2)
    torch.testing.assert_close(kp, kp[:, :1].expand_as(kp))
    assert float((kp[:, 0] < 1).float().mean()) == pytest.approx(0.5, abs=0.1)
    added = fields.added("actuator_gainprm")
    added[..., [KP_INDEX, KD_INDEX]] = 0
    assert (added == 0).all()


def test_the_torque_limit_is_drawn_log_uniformly_for_the_whole_robot_after_the_gains() -> None:
    fields, randomizer = build(kp=[0.5, 2.0], torque_limit=[0.5, 2.0])
    randomizer.new_episodes(fields, everywhere())
    limits = fields.ratio("actuator_forcerange")
    assert_fills(limits, 0.5, 2.0)
    torch.testing.assert_close(limits, limits[:, :1, :1].expand_as(limits))
    assert float((limits[:, 0, 0] < 1).float().mean()) == pytest.approx(0.5, abs=0.1)
    motors = fields.field("actuator_gainprm")
    nominal = torch.from_numpy(fields.model.actuator_gainprm)
    torch.testing.assert_close(motors[..., RESISTANCE_INDEX] * limits[..., 0], nominal[:, 0].expand(WORLDS, -1))
    gains, other = build(kp=[0.5, 2.0])
    other.new_episodes(gains, everywhere())
    assert torch.equal(motors[..., 1:], gains.field("actuator_gainprm")[..., 1:])
    before = limits.clone()
    randomizer.new_episodes(fields, torch.tensor([3]))
    changed = (fields.ratio("actuator_forcerange") != before).all(-1).all(-1)
    assert changed.nonzero().squeeze(1).tolist() == [3]
    assert_fills(fields.ratio("actuator_forcerange"), 0.5, 2.0)


def test_the_torque_limit_can_be_drawn_alone() -> None:
    fields, randomizer = build(torque_limit=[0.5, 0.5])
    randomizer.new_episodes(fields, everywhere())
    ratio = fields.ratio("actuator_gainprm")
    assert (ratio[..., RESISTANCE_INDEX] == 2).all() and (ratio[..., [KP_INDEX, KD_INDEX]] == 1).all()
    assert (fields.ratio("actuator_forcerange") == 0.5).all()


def test_gains_are_redrawn_only_where_an_episode_starts_and_do_not_accumulate() -> None:
    fields, randomizer = build(kp=[0.8, 1.25], kd=[0.8, 1.2])
    randomizer.new_episodes(fields, everywhere())
    mask = torch.arange(WORLDS) % 3 == 0
    for _ in range(30):
        before = fields.field("actuator_gainprm").clone()
        randomizer.new_episodes(fields, mask.nonzero().squeeze(1))
        after = fields.field("actuator_gainprm")
        assert torch.equal(after[~mask], before[~mask])
        assert (after[mask] != before[mask])[..., KP_INDEX].all()
    ratio = (
        fields.field("actuator_gainprm")[..., KP_INDEX] / torch.from_numpy(fields.model.actuator_gainprm)[:, KP_INDEX]
    )
    assert_fills(ratio[mask], 0.8, 1.25)


def test_drawing_again_starts_from_the_nominal_values() -> None:
    ranges = dict(
        friction=[0.5, 1.5],
        trunk_mass=[-1.0, 1.0],
        trunk_com=[-0.02, 0.02],
        inertia=[0.8, 1.2],
        board_mass=[0.5, 1.5],
        truck_stiffness=[0.5, 1.5],
    )
    fields, _ = build(seed=0, **ranges)
    once = {name: value.clone() for name, value in fields.fields.items()}
    for _ in range(3):
        build(seed=1, fields=fields, **ranges)
    assert all((fields.field(name) != value).any() for name, value in once.items())
    build(seed=0, fields=fields, **ranges)
    for name, value in once.items():
        torch.testing.assert_close(fields.field(name), value, rtol=0, atol=0)


@pytest.mark.parametrize(
    "setting, value",
    [
        ("friction", [1.2, 0.7]),
        ("friction", [0.0, 1.0]),
        ("kp", [-1.0, 1.0]),
        ("kd", [1.0]),
        ("torque_limit", [0.0, 1.0]),
        ("inertia", [math.nan, 1.0]),
        ("trunk_mass", [1.0, -1.0]),
        ("trunk_com", [0.0, math.inf]),
        ("board_mass", [0.0, 0.0]),
        ("truck_stiffness", [-0.1, 1.0]),
        ("push_interval", [0.0, 1.0]),
        ("push_velocity", [0.5, -0.5]),
    ],
)
def test_a_range_that_cannot_be_drawn_is_named(setting: str, value: list[float]) -> None:
    with pytest.raises(ConfigError, match=rf"randomization\.{setting}=.*must be") as error:
        defaults.randomization(**{setting: value}).validate()
    assert "\n" not in str(error.value)


def pushes(seed: int = 0, worlds: int = 50, **ranges: list[float]) -> Pushes:
    return Pushes(defaults.randomization(**ranges), worlds, 0.04, torch.Generator().manual_seed(seed))


def test_there_are_no_pushes_unless_asked_for() -> None:
    assert not pushes().active
    assert not pushes(push_interval=[1.0, 2.0]).active
    assert not pushes(push_velocity=[-1.0, 1.0]).active
    assert pushes(push_interval=[1.0, 2.0], push_velocity=[-1.0, 1.0]).active


def test_pushes_come_at_random_intervals_within_the_range() -> None:
    source = pushes(push_interval=[1.0, 2.0], push_velocity=[-0.5, 0.4])
    due, velocities = zip(*(source.due() for _ in range(300)))
    times = torch.stack(due)
    assert (times.any(0)).all()
    for world in range(50):
        steps = torch.nonzero(times[:, world]).squeeze(1)
        waits = torch.cat((steps[:1] + 1, steps.diff())) * 0.04
        assert waits.min() >= 1.0 - 1e-4 and waits.max() <= 2.0 + 0.04 + 1e-4
    pushed = torch.stack(velocities)[times]
    assert_fills(pushed[:, 0], -0.5, 0.4)
    assert_fills(pushed[:, 1], -0.5, 0.4)
    assert (pushed[:, 2] == 0).all()


def test_a_new_episode_waits_a_new_interval() -> None:
    source = pushes(push_interval=[1.0, 1.0], push_velocity=[-0.5, 0.5])
    for _ in range(20):
        assert not source.due()[0].any()
    mask = torch.arange(50) < 10
    source.restart(mask)
    due = torch.stack([source.due()[0] for _ in range(30)]).int().argmax(0)
    assert (due[:10] - due[10] == 20).all() and (due[10:] == due[10]).all()


def test_pushes_repeat_with_their_generator() -> None:
    def course(seed: int) -> Tensor:
        source = pushes(seed, push_interval=[0.1, 0.5], push_velocity=[-0.5, 0.5])
        return torch.stack(
            [torch.cat((due.unsqueeze(1), velocity), 1) for due, velocity in (source.due() for _ in range(20))]
        )

    assert torch.equal(course(0), course(0))
    assert not torch.equal(course(0), course(1))


def test_what_the_engine_derives_from_masses_follows_them(make_env) -> None:
    ranges = ["randomization=none", "randomization.trunk_mass=[1.0,3.0]"]
    env = make_env("balance", 3, ranges)
    physics = env.physics
    trunk = physics.index.trunk_body
    mass, subtree = physics.field("body_mass"), physics.field("body_subtreemass")
    added = mass[:, trunk] - physics.model.body_mass[trunk]
    assert (added >= 1.0).all() and len(added.unique()) == 3
    torch.testing.assert_close(subtree[:, trunk] - physics.model.body_subtreemass[trunk], added)
