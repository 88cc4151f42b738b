from __future__ import annotations

import exported
import numpy as np
import pytest

from skatemount.runner.controller import Controller
from skatemount.runner.folder import PolicyFolder, RunnerError


@pytest.fixture(scope="module")
def folder() -> PolicyFolder:
    return PolicyFolder(exported.folder())


def measured(folder: PolicyFolder, row: int = 0) -> dict[str, np.ndarray]:
    vectors = folder.arrays("vectors.npz")
    return {name: vectors[f"observe.{name}"][row] for name in Controller(folder).measurements}


def test_the_first_step_repeats_a_vector(folder: PolicyFolder) -> None:
    controller, vectors = Controller(folder), folder.arrays("vectors.npz")
    targets = controller.step(measured(folder))
    np.testing.assert_allclose(targets, vectors["policy.targets"][0], atol=1e-5)
    np.testing.assert_allclose(controller.action, vectors["policy.action"][0], atol=1e-5)
    np.testing.assert_allclose(controller.observation, vectors["policy.observation"][0], atol=1e-5)


def test_it_remembers_until_an_episode_begins(folder: PolicyFolder) -> None:
    controller = Controller(folder)
    first = controller.step(measured(folder))
    assert (controller.step(measured(folder)) != first).any()
    controller.begin()
    assert (controller.step(measured(folder)) == first).all()


def test_noise_changes_the_observation_by_no_more_than_its_size(folder: PolicyFolder) -> None:
    controller = Controller(folder)
    controller.step(measured(folder))
    plain = controller.observation
    controller.begin()
    controller.step(measured(folder), np.ones(controller.noise_size))
    difference = controller.observation - plain
    for term in folder.card["observation"]["terms"]:
        part = difference[term["start"] : term["stop"]]
        np.testing.assert_allclose(part, term["noise"] * term["scale"], atol=1e-5)


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("joint_pos", None, "measurement joint_pos is missing; the policy needs "),
        ("joint_pos", np.zeros(11), "measurement joint_pos has shape [11]; it must be [12]"),
        ("gravity", [0.0, np.nan, -1.0], "measurement gravity=[0.0, nan, -1.0] must be finite"),
    ],
)
def test_a_measurement_that_cannot_be_used(folder: PolicyFolder, name: str, value: object, expected: str) -> None:
    values: dict[str, object] = dict(measured(folder))
    if value is None:
        del values[name]
    else:
        values[name] = value
    with pytest.raises(RunnerError) as error:
        Controller(folder).step(values)
    assert str(error.value).startswith(expected)
