from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import defaults
import mujoco
import numpy as np
import pytest
from dm_control import mjcf
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from skatemount.envs.config.board import SkateboardConfig
from skatemount.envs.entities.arena import MountArena
from skatemount.envs.entities.skateboard import WELD_SOLIMP, WELD_SOLREF, Skateboard
from skatemount.utils.errors import ConfigError

PRESETS = ("default", "paper_text", "isaac", "longboard", "mini", "carver", "surfskate")
GRAVITY = 9.81
ROBOT_MASS = 12.453
ROBOT_HEIGHT = 0.30  # of the trunk above the deck; the robot's center of mass is a little lower


def preset(name: str) -> SkateboardConfig:
    folder = Path(__file__).parents[3] / "conf" / "board"
    with initialize_config_dir(str(folder), version_base="1.3"):
        values = compose(name)
    merged = OmegaConf.merge(OmegaConf.structured(SkateboardConfig), values)
    return OmegaConf.to_object(merged)


class World:
    """A board on the floor, alone, with what the tests push and read."""

    def __init__(
        self,
        config: SkateboardConfig,
        timestep: float = 0.005,
        weld: bool = False,
        rider: float = 0.0,
    ):
        self.config = config
        arena = MountArena()
        model = arena.mjcf_model
        option = model.option
        option.set_attributes(timestep=timestep, integrator="implicitfast", solver="Newton")
        self.board = Skateboard(config)
        self.frame = arena.add_free_entity(self.board)
        self.frame.pos = (0, 0, config.deck_height)
        if rider:
            body = self.board.mjcf_model.worldbody
            place = {"pos": (0, 0, ROBOT_HEIGHT), "size": (0.05,)}
            body.add("geom", type="sphere", mass=rider, contype=0, conaffinity=0, **place)
        if weld:
            arena.mjcf_model.equality.add("weld", body1=self.frame, solref=WELD_SOLREF, solimp=WELD_SOLIMP)
        self.physics = mjcf.Physics.from_mjcf_model(arena.mjcf_model)
        self.free = self.physics.bind(self.frame.freejoint)
        self.body = self.physics.bind(self.frame)
        self.trucks = self.physics.bind(self.board.truck_joints)
        self.wheels = self.physics.bind(self.board.wheel_joints)
        self.tyres = self.physics.bind(self.board.wheel_geoms)

    @property
    def position(self) -> np.ndarray:
        return np.array(self.body.xpos)

    @property
    def rotation(self) -> np.ndarray:
        return np.array(self.body.xmat).reshape(3, 3)

    @property
    def lean(self) -> float:
        """Roll of the deck, positive to the right."""
        return math.asin(self.rotation[2, 1])

    @property
    def heading(self) -> float:
        return math.atan2(self.rotation[1, 0], self.rotation[0, 0])

    @property
    def forward_speed(self) -> float:
        return float(self.rotation[:, 0] @ np.array(self.free.qvel)[:3])

    def axle(self, right: int, left: int) -> np.ndarray:
        """Unit vector along an axle to the left, in a frame that has the board's heading."""
        axle = self.tyres.xpos[left] - self.tyres.xpos[right]
        axle /= np.linalg.norm(axle)
        c, s = math.cos(self.heading), math.sin(self.heading)
        return np.array([c * axle[0] + s * axle[1], c * axle[1] - s * axle[0], axle[2]])

    def run(self, seconds: float, force=(0, 0, 0), torque=(0, 0, 0), point=None) -> None:
        """Steps with a force and torque given in a level frame that has the board's heading.

        Args:
            seconds: how long.
            force: N, at ``point`` of the board frame, or at the board's center of mass.
            torque: N m.
            point: m.
        """
        for _ in range(round(seconds / self.physics.timestep())):
            c, s = math.cos(self.heading), math.sin(self.heading)
            level = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
            push, turn = level @ np.array(force, float), level @ np.array(torque, float)
            if point is not None:
                arm = self.position + self.rotation @ np.array(point) - self.body.xipos
                turn = turn + np.cross(arm, push)
            self.body.xfrc_applied = np.concatenate([push, turn])
            self.physics.step()
        mujoco.mj_forward(self.physics.model.ptr, self.physics.data.ptr)

    def start_rolling(self, speed: float) -> None:
        self.free.qvel = [speed, 0, 0, 0, 0, 0]
        self.wheels.qvel = speed / self.config.wheel_radius


def soft(angle: float = 45.0) -> SkateboardConfig:
    """A board soft enough that torques too small to lift a wheel lean it well."""
    return defaults.board(truck_angle=angle, truck_stiffness=2.0, truck_limit=12.0)


@pytest.mark.parametrize("timestep", [0.005, 0.010])
@pytest.mark.parametrize("name", PRESETS)
def test_wheels_touch_the_floor_at_rest(name: str, timestep: float) -> None:
    world = World(preset(name), timestep)
    radius = world.config.wheel_radius
    np.testing.assert_allclose(world.tyres.xpos[:, 2], radius, atol=1e-9)
    world.run(1.0)
    assert world.physics.data.ncon == 4
    assert np.all(world.tyres.xpos[:, 2] < radius)
    assert world.config.deck_height - world.position[2] < 1e-3
    assert np.linalg.norm(world.position[:2]) < 1e-4
    assert abs(world.lean) < 1e-4
    assert np.abs(world.free.qvel).max() < 1e-4


@pytest.mark.parametrize("name", PRESETS)
def test_masses_add_up(name: str) -> None:
    world = World(preset(name))
    total = world.physics.model.body_subtreemass[world.body.element_id]
    assert total == pytest.approx(world.config.mass)
    assert world.config.deck_mass > 0.4 * world.config.mass


def test_the_isaac_preset_has_the_papers_masses_and_limits() -> None:
    config = preset("isaac")
    assert config.deck_mass == pytest.approx(1.87356, abs=1e-4)
    assert math.radians(config.truck_angle) == pytest.approx(0.38044, abs=1e-4)
    assert config.roll_stiffness == pytest.approx(72.5, abs=0.1)
    assert math.degrees(config.max_lean) == pytest.approx(4.9, abs=0.05)
    assert math.degrees(config.steering_angle(config.max_lean)) == pytest.approx(12.1, abs=0.1)


def test_the_default_preset_is_the_dataclass() -> None:
    assert preset("default") == defaults.board()


@pytest.mark.parametrize("angle", [21.8, 45.0, 60.0])
@pytest.mark.parametrize("torque", [0.8, -0.5])
def test_leaning_steers(angle: float, torque: float) -> None:
    world = World(soft(angle))
    world.run(3.0, torque=(torque, 0, 0))
    assert world.physics.data.ncon == 4
    lean = world.lean
    assert np.sign(lean) == np.sign(torque)
    assert abs(lean) > 0.015
    theta = math.radians(angle)
    for (right, left), sign, joint in (((0, 1), 1, 0), ((2, 3), -1, 1)):
        axle = world.axle(right, left)
        steer = sign * math.atan2(axle[0], axle[1])  # positive: the front axle to the right
        phi = -sign * world.trucks.qpos[joint]
        assert abs(axle[2]) < 1e-3
        # The truck angle's relations and the law, each on its own.
        assert math.tan(lean) == pytest.approx(math.sin(theta) * math.tan(phi), rel=0.02)
        assert math.sin(steer) == pytest.approx(math.cos(theta) * math.sin(phi), rel=0.02)
        assert steer == pytest.approx(world.config.steering_angle(lean), rel=0.02)
        assert phi == pytest.approx(world.config.truck_rotation(lean), rel=0.02)
        if angle == 45.0:
            assert steer == pytest.approx(lean, rel=0.02)


@pytest.mark.parametrize("timestep", [0.005, 0.010])
@pytest.mark.parametrize("torque", [0.6, -0.6])
def test_a_leaning_board_turns_to_its_side_on_the_laws_radius(torque: float, timestep: float) -> None:
    world = World(soft(), timestep)
    world.run(1.0, torque=(torque, 0, 0))
    world.start_rolling(1.0)
    world.run(0.5, torque=(torque, 0, 0))
    before, distance = world.heading, 0.0
    leans = []
    for _ in range(100):
        world.run(0.01, torque=(torque, 0, 0))
        distance += 0.01 * world.forward_speed
        leans.append(world.lean)
    turned = before - world.heading  # positive to the right
    assert np.sign(turned) == np.sign(torque)
    assert distance / abs(turned) == pytest.approx(world.config.turning_radius(float(np.mean(leans))), rel=0.05)


@pytest.mark.parametrize("torque", [1.0, -1.0, 0.5])
def test_roll_torque_over_lean_is_the_roll_stiffness(torque: float) -> None:
    config = dataclasses.replace(defaults.board(), truck_stiffness=5.0)
    world = World(config)
    world.run(3.0, torque=(torque, 0, 0))
    # The deck's weight, above the axis, helps it to lean.
    deck = config.deck_mass * GRAVITY * (config.roll_axis_depth - config.deck_thickness / 2)
    assert torque / world.lean + deck == pytest.approx(config.roll_stiffness, rel=0.03)


@pytest.mark.parametrize("timestep", [0.005, 0.010])
def test_the_stop_holds_more_than_the_robots_weight(timestep: float) -> None:
    world = World(defaults.board(), timestep)
    world.run(2.0, force=(0, 0, -250), point=(0, -0.05, 0))
    assert world.lean > world.config.max_lean
    assert world.lean < 1.05 * world.config.max_lean
    assert world.physics.data.ncon == 4


@pytest.mark.parametrize("timestep", [0.005, 0.010])
@pytest.mark.parametrize("name", PRESETS)
def test_a_loaded_board_stands_still(name: str, timestep: float) -> None:
    world = World(preset(name), timestep)
    load = {"force": (0, 0, -ROBOT_MASS * GRAVITY), "point": (0.05, -0.01, 0)}
    world.run(2.0, **load)
    for _ in range(20):
        world.run(timestep, **load)
        assert np.abs(world.free.qvel).max() < 2e-3
        assert np.all(world.config.wheel_radius - world.tyres.xpos[:, 2] < 1e-3)
        assert np.all(world.tyres.xpos[:, 2] < world.config.wheel_radius)


def robot_roll_load(config: SkateboardConfig) -> float:
    """m g h of the robot and the deck about the roll axis, N m/rad."""
    robot = ROBOT_MASS * GRAVITY * (ROBOT_HEIGHT + config.roll_axis_depth)
    deck = config.deck_mass * GRAVITY * (config.roll_axis_depth - config.deck_thickness / 2)
    return robot + deck


@pytest.mark.parametrize("name", ["default", "longboard", "mini", "carver", "surfskate"])
def test_boards_to_ride_hold_the_robot_up(name: str) -> None:
    config = preset(name)
    assert config.roll_stiffness > 1.15 * robot_roll_load(config)
    # At the stop a robot leaning with the deck still has its weight between the wheels.
    height = ROBOT_HEIGHT + config.roll_axis_depth
    assert height * math.sin(config.max_lean) < 0.6 * config.track / 2


@pytest.mark.parametrize("timestep", [0.005, 0.010])
@pytest.mark.parametrize(("name", "holds"), [("default", True), ("paper_text", False)])
def test_a_rider_of_the_robots_mass_stays_level_if_the_board_is_stiff_enough(
    name: str, holds: bool, timestep: float
) -> None:
    world = World(preset(name), timestep, rider=ROBOT_MASS)
    world.run(0.5)
    world.run(0.2, torque=(4.0, 0, 0))
    largest = 0.0
    for _ in range(30):
        world.run(0.1)
        largest = max(largest, abs(world.lean))
    if holds:
        assert largest < world.config.max_lean
        assert abs(world.lean) < 0.05 * world.config.max_lean
    else:
        assert largest > world.config.max_lean


@pytest.mark.parametrize("timestep", [0.005, 0.010])
@pytest.mark.parametrize("name", ["default", "paper_text", "longboard", "mini"])
def test_the_free_board_coasts_and_loses_speed_by_its_own_friction(name: str, timestep: float) -> None:
    # The entity has the bearings' friction only; the environment adds the resistance of the load.
    world = World(dataclasses.replace(preset(name), wheel_friction=0.0015), timestep)
    world.run(0.5)
    world.start_rolling(1.0)
    speeds = [1.0]
    while speeds[-1] > 0.02 and len(speeds) < 400:
        world.run(0.05)
        speeds.append(world.forward_speed)
    assert np.all(np.diff(speeds) < 0)
    assert 2.0 < world.position[0] < 10.0
    assert abs(world.position[1]) < 0.02
    world.run(1.0)
    assert abs(world.forward_speed) < 5e-3


def test_rolling_wheels_do_not_slip() -> None:
    world = World(defaults.board())
    world.start_rolling(1.0)
    world.run(1.0)
    rolled = world.wheels.qvel * world.config.wheel_radius
    np.testing.assert_allclose(rolled, world.forward_speed, rtol=0.01)


@pytest.mark.parametrize("timestep", [0.005, 0.010])
def test_the_isaac_board_does_not_roll(timestep: float) -> None:
    world = World(preset("isaac"), timestep)
    world.run(0.5)
    world.free.qvel = [1.0, 0, 0, 0, 0, 0]
    world.run(2.0)
    assert 0 < world.position[0] < 0.1
    assert abs(world.forward_speed) < 1e-3


@pytest.mark.parametrize("timestep", [0.005, 0.010])
@pytest.mark.parametrize("name", ["default", "longboard", "mini"])
@pytest.mark.parametrize("corner", [(0.4, 0.45), (-0.4, -0.45)])
def test_a_welded_deck_does_not_move(name: str, corner: tuple[float, float], timestep: float) -> None:
    config = preset(name)
    world = World(config, timestep, weld=True)
    start, level = world.position, world.rotation
    point = (corner[0] * config.deck_length, corner[1] * config.deck_width, 0)
    world.run(1.0, force=(20, 20, -120), point=point)
    turned = level.T @ world.rotation
    angle = math.acos(min(1.0, (np.trace(turned) - 1) / 2))
    assert np.linalg.norm(world.position - start) < 1e-3
    assert math.degrees(angle) < 0.2


def test_the_same_load_moves_the_free_deck() -> None:
    world = World(defaults.board())
    world.run(1.0, force=(0, 0, -120), point=(0.2, 0.07, 0))
    assert abs(world.lean) > math.radians(2)


def test_the_root_frame_is_the_center_of_the_decks_top() -> None:
    world = World(defaults.board())
    site = world.physics.bind(world.board.deck_site)
    deck = world.physics.bind(world.board.deck_geom)
    np.testing.assert_allclose(site.xpos, [0, 0, 0.088], atol=1e-12)
    np.testing.assert_allclose(deck.xpos[2] + deck.size[2], 0.088, atol=1e-12)
    np.testing.assert_allclose(deck.size, [0.2875, 0.125, 0.006])


def test_only_the_deck_box_and_four_spheres_collide() -> None:
    world = World(defaults.board())
    geoms = world.board.mjcf_model.find_all("geom")
    solid = [world.board.deck_geom, *world.board.wheel_geoms]
    assert [geom.name for geom in solid] == [
        "deck",
        *(f"{wheel}_wheel" for wheel in ("FR", "FL", "RR", "RL")),
    ]
    bound = world.physics.bind(geoms)
    colliding = np.flatnonzero(np.array(bound.contype) | np.array(bound.conaffinity))
    assert len(colliding) == len(solid)
    bits = world.physics.bind(solid)
    assert set(bits.contype) == {2} and set(bits.conaffinity) == {1}
    right, left = world.tyres.xpos[[0, 2], 1], world.tyres.xpos[[1, 3], 1]
    assert np.all(right < 0) and np.all(left > 0)


def test_the_wheels_bring_hardly_any_inertia() -> None:
    world = World(defaults.board())
    mass = np.zeros((world.physics.model.nv, world.physics.model.nv))
    mujoco.mj_fullM(world.physics.model.ptr, world.physics.data.ptr, mass)
    dofs = world.physics.model.jnt_dofadr[world.wheels.element_id]
    equivalent = mass[dofs, dofs] / world.config.wheel_radius**2
    assert np.all(equivalent < world.config.wheel_mass)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"mass": 0.2}, "mass"),
        ({"wheel_radius": 0.0}, "wheel_radius"),
        ({"deck_length": -1.0}, "deck_length"),
        ({"truck_stiffness": -2.0}, "truck_stiffness"),
        ({"truck_angle": 0.0}, "truck_angle"),
        ({"truck_angle": 90.0}, "truck_angle"),
        ({"truck_limit": 70.0}, "truck_limit"),
        ({"truck_limit": math.nan}, "truck_limit"),
        ({"wheelbase": 0.6}, "wheelbase"),
        ({"deck_height": 0.06}, "deck_height"),
        ({"track": 0.02}, "track"),
        ({"kick_angle": 60.0}, "kick_angle"),
        ({"deck_color": [0.1, 2.0, 0.3]}, "deck_color"),
    ],
)
def test_a_bad_setting_is_named(change: dict[str, float], named: str) -> None:
    config = dataclasses.replace(defaults.board(), **change)
    with pytest.raises(ConfigError, match=rf"^board\.{named}=") as caught:
        Skateboard(config)
    assert "\n" not in str(caught.value)
    assert repr(change[named]) in str(caught.value)
