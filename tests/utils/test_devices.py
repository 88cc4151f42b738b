"""Devices by name, torch's threads, and random states."""

from __future__ import annotations

import pytest
import torch

from skatemount.utils.cores import CORES, available_cores
from skatemount.utils.devices import choose_device, rng_state, seconds, set_rng_state, torch_threads
from skatemount.utils.errors import ConfigError

CPU = torch.device("cpu")


def test_auto_is_a_gpu_if_there_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert choose_device("auto") == choose_device("cpu") == CPU
    asked = []
    zeros = torch.zeros
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch, "zeros", lambda size, device: asked.append(device) or zeros(size))
    choose_device("auto")
    assert asked == ["cuda"]


@pytest.mark.parametrize("name", ["gpu", "cuda:", "cuda:one", "mps"])
def test_other_names_are_refused_in_one_line(name: str) -> None:
    with pytest.raises(ConfigError) as error:
        choose_device(name)
    assert str(error.value) == f"physics.device={name} must be auto, cpu, cuda or cuda:<number>"


def test_a_device_that_is_not_there_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(size: int, device: str) -> torch.Tensor:
        raise RuntimeError("invalid device ordinal\nmore about it")

    monkeypatch.setattr(torch, "zeros", fail)
    with pytest.raises(ConfigError) as error:
        choose_device("cuda:7")
    assert str(error.value) == "physics.device=cuda:7 cannot be used: invalid device ordinal"


def test_the_clock_does_not_go_back() -> None:
    assert seconds(CPU) <= seconds(CPU)


def test_threads_are_restored_even_after_an_error() -> None:
    before = torch.get_num_threads()
    with pytest.raises(KeyError), torch_threads(before + 1):
        assert torch.get_num_threads() == before + 1
        raise KeyError
    assert torch.get_num_threads() == before
    with torch_threads(None):
        assert torch.get_num_threads() == before


def test_a_restored_random_state_repeats_its_numbers() -> None:
    state = rng_state(CPU).clone()
    first = torch.rand(3)
    assert not torch.equal(torch.rand(3), first)
    set_rng_state(state, CPU)
    assert torch.equal(torch.rand(3), first)


def test_a_process_uses_its_share_of_the_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in (CORES, "LOCAL_WORLD_SIZE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("os.sched_getaffinity", lambda process: set(range(8)), raising=False)
    assert available_cores() == 8
    monkeypatch.setenv(CORES, "6")
    assert available_cores() == 6
    monkeypatch.setenv("LOCAL_WORLD_SIZE", "2")
    assert available_cores() == 3
    monkeypatch.setenv(CORES, "100")
    assert available_cores() == 4


@pytest.mark.parametrize("wrong", ["0", "-1", "two", "1.5"])
def test_a_wrong_number_of_cores_is_one_line(wrong: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(CORES, wrong)
    with pytest.raises(ConfigError, match=f"^SKATEMOUNT_CORES={wrong} in the environment must be a whole number"):
        available_cores()
