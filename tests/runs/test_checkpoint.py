from __future__ import annotations

import hashlib
import io
import json
import math
import os
import pickle
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from skatemount.runs import atomic
from skatemount.runs.checkpoint import (
    POLICY_FILE,
    PolicyCard,
    is_checkpoint,
    keep_last,
    list_checkpoints,
    load_policy,
    load_training_state,
    read_card,
    save_checkpoint,
    save_policy,
    step_folder,
)
from skatemount.runs.serialization import load_state, save_state
from skatemount.utils.errors import ConfigError


def card(**changes: Any) -> PolicyCard:
    fields = {"stage": "balance", "config": {"seed": 1, "scale": [0.25, 1e-5], "none": None}}
    return PolicyCard(**{**fields, **changes})


def network(value: float = 0.5) -> torch.nn.Module:
    net = torch.nn.Sequential(torch.nn.Linear(3, 4), torch.nn.BatchNorm1d(4))
    torch.nn.init.constant_(net[0].weight, value)
    return net


def same(a: Any, b: Any) -> bool:
    """Equality that also looks at types, dtypes, shapes and the order of keys."""
    if type(a) is not type(b):
        return False
    if isinstance(a, dict):
        return list(a) == list(b) and all(same(a[k], b[k]) for k in a)
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, torch.Tensor):
        return a.dtype == b.dtype and a.shape == b.shape and torch.equal(a, b)
    if isinstance(a, np.ndarray | np.generic):
        return a.dtype == b.dtype and a.shape == b.shape and np.array_equal(a, b)
    return a == b or (isinstance(a, float) and math.isnan(a) and math.isnan(b))


def test_policy_round_trip(tmp_path: Path) -> None:
    actor, critic = network(1.0), network(2.0)
    critic[0].weight = actor[0].weight  # shared memory is no obstacle
    file = tmp_path / "p.safetensors"
    written = card(
        frames=12,
        metrics={"a": 0.1, "nan": float("nan"), "inf": np.float32(math.inf), "t": torch.tensor(2)},
        observation=[{"key": "observation", "name": "gravity", "size": 3, "scale": 1.0}],
        notes="ä",
    )
    save_policy(file, {"actor": actor, "critic": critic}, written)
    modules, read = load_policy(file)
    assert set(modules) == {"actor", "critic"}
    for name, module in {"actor": actor, "critic": critic}.items():
        expected = module.state_dict()
        assert set(modules[name]) == set(expected)
        assert all(same(modules[name][key], value) for key, value in expected.items())
    fresh = network(0.0)
    fresh.load_state_dict(modules["critic"])
    assert torch.equal(fresh[0].weight, actor[0].weight)
    assert read.config == written.config and read.observation == written.observation
    assert read.frames == 12 and read.notes == "ä" and read.metrics["t"] == 2
    assert math.isnan(read.metrics["nan"]) and read.metrics["inf"] == math.inf
    assert written.sha256 == ""
    strict = file.with_suffix(".json").read_text()
    assert "NaN" not in strict and "Infinity" not in strict
    assert read_card(file).sha256 == read.sha256


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": 2}, "newer"),
        ({"format": "1"}, "format='1'"),
        ({"stage": 3}, "'stage' is a int"),
        ({"frames": True}, "'frames' is a bool"),
        ({"observation": ["x"]}, "'observation'"),
        ({"speling": 1}, "unknown field 'speling'"),
    ],
)
def test_malformed_cards_are_named(change: dict[str, Any], message: str) -> None:
    document = {**json.loads(card().to_json()), **change}
    with pytest.raises(ConfigError, match=message) as error:
        PolicyCard.from_json(json.dumps(document), "some/policy.json")
    assert str(error.value).startswith("some/policy.json") and "\n" not in str(error.value)


@pytest.mark.parametrize("text", ["", "{", "[]", '{"format": 1, "stage": "x"}', "nul\0"])
def test_a_card_that_is_not_one_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="some/policy.json"):
        PolicyCard.from_json(text, "some/policy.json")


def test_a_card_takes_only_plain_data(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="config.path"):
        save_policy(tmp_path / "p.safetensors", {"actor": network()}, card(config={"path": tmp_path}))
    assert list(tmp_path.iterdir()) == []


def test_training_state_round_trip_is_exact(tmp_path: Path) -> None:
    net = network()
    state = {
        "networks": dict(net.state_dict()),
        "generators": {"torch": torch.Generator().manual_seed(7).get_state()},
        "floats": [0.1, -0.0, math.pi, 1e-320, math.nan, math.inf, -math.inf],
        "plain": {"a": None, "b": True, "c": 2**127 + 1, "d": "ä$", "": [], "e": {}, "f": [[1], "x"]},
        "a": {"b": torch.ones(1), "$tensor": "a.b"},
        "a.b": torch.zeros(1),
        "tensors": {
            "scalar": torch.tensor(3.0, dtype=torch.float64),
            "empty": torch.zeros(0, 3),
            "bool": torch.tensor([True, False]),
            "half": torch.randn(3).to(torch.bfloat16),
            "strided": torch.arange(12).reshape(3, 4).T,
            "nan": torch.tensor([math.inf, 1.0]),
            "shared": net[0].weight.detach()[0],
        },
        "nothing": {},
    }
    save_state(tmp_path / "s", state)
    loaded = load_state(tmp_path / "s")
    assert set(loaded) == set(state)
    for key, value in state.items():
        assert same(sort(loaded[key]), sort(value)), key


def sort(value: Any) -> Any:
    return dict(sorted(value.items())) if isinstance(value, dict) else value


@pytest.mark.parametrize("value", [object(), (1, 2), np.float64(0.1), np.zeros(2), [torch.ones(1)], [1, {"x": 2}]])
def test_what_cannot_be_saved_is_named_with_its_place(tmp_path: Path, value: Any) -> None:
    with pytest.raises(ConfigError, match=f"^callbacks/Mine: a {type(value).__name__} cannot be saved"):
        save_state(tmp_path, {"callbacks": {"Mine": value}})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("key", [3, "a/b", ("obs", 0)])
def test_keys_that_are_no_names_are_refused(tmp_path: Path, key: Any) -> None:
    with pytest.raises(ConfigError, match=re.escape(f"curriculum: the key {key!r}")):
        save_state(tmp_path, {"curriculum": {key: 0}})


def test_a_tensor_that_has_no_place_is_refused(tmp_path: Path) -> None:
    save_state(tmp_path, {"a": {"x": torch.ones(1)}})
    document = json.loads((tmp_path / "state.json").read_text())
    document |= {"state": {}, "state_sha256": hashlib.sha256(b"{}").hexdigest()}
    (tmp_path / "state.json").write_text(json.dumps(document))
    with pytest.raises(ConfigError, match="not a saved state"):
        load_state(tmp_path)


def test_checkpoint_round_trip_and_layout(tmp_path: Path) -> None:
    folder = tmp_path / step_folder(1_234_567)
    assert folder.name == "step_000001234567"
    save_checkpoint(folder, {"actor": network(3.0)}, card(frames=5), {"frames": 5})
    modules, read = load_policy(folder)
    assert modules["actor"]["0.weight"][0, 0] == 3.0 and read.frames == 5
    assert load_training_state(folder) == {"frames": 5}
    assert [p.name for p in tmp_path.iterdir()] == [folder.name]
    save_policy(tmp_path / "alone.safetensors", {"actor": network()}, card())
    with pytest.raises(ConfigError, match="no training state"):
        load_training_state(tmp_path / "alone.safetensors")


@pytest.mark.parametrize("name", [POLICY_FILE, "training/tensors.safetensors", "training/state.json", "policy.json"])
@pytest.mark.parametrize("keep", [0.0, 0.01, 0.5, 0.999])
def test_truncated_files_are_refused_by_name(tmp_path: Path, name: str, keep: float) -> None:
    folder = tmp_path / step_folder(1)
    save_checkpoint(folder, {"actor": network()}, card(), {"x": torch.randn(100), "n": [1] * 99})
    file = folder / name
    data = file.read_bytes()
    # Without its last line end, a JSON file would still be whole.
    file.write_bytes(data[: min(int(len(data) * keep), len(data) - 2)])
    with pytest.raises(ConfigError, match=name) as error:
        load_policy(folder)
        load_training_state(folder)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", [POLICY_FILE, "training/tensors.safetensors"])
def test_a_flipped_bit_is_noticed(tmp_path: Path, name: str) -> None:
    folder = tmp_path / step_folder(1)
    save_checkpoint(folder, {"actor": network()}, card(), {"x": torch.randn(100)})
    data = bytearray((folder / name).read_bytes())
    data[-5] ^= 1
    (folder / name).write_bytes(data)
    with pytest.raises(ConfigError, match="checksum"):
        load_policy(folder)
        load_training_state(folder)


def test_edited_state_is_noticed(tmp_path: Path) -> None:
    save_state(tmp_path, {"frames": 1000})
    file = tmp_path / "state.json"
    file.write_text(file.read_text().replace("1000", "2000"))
    with pytest.raises(ConfigError, match="checksum"):
        load_state(tmp_path)


class Malicious:
    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (str(self.path),)


@pytest.mark.parametrize("writer", ["pickle", "torch"])
def test_a_pickle_in_disguise_is_not_run(tmp_path: Path, writer: str) -> None:
    folder, trap = tmp_path / step_folder(1), tmp_path / "trap"
    save_checkpoint(folder, {"actor": network()}, card(), {"x": torch.ones(1)})
    for file in (folder / POLICY_FILE, folder / "training" / "tensors.safetensors"):
        if writer == "pickle":
            file.write_bytes(pickle.dumps(Malicious(trap)))
        else:
            torch.save({"x": Malicious(trap)}, file)
    for load in (load_policy, load_training_state):
        with pytest.raises(ConfigError, match="pickle"):
            load(folder)
    assert not trap.exists()
    data = (folder / POLICY_FILE).read_bytes()
    if writer == "pickle":
        pickle.loads(data)
    else:
        torch.load(io.BytesIO(data), weights_only=False)
    assert trap.exists()  # so the trap was a real one


@pytest.mark.parametrize("suffix", [".pt", ".pth", ".pkl", ".ckpt", ""])
def test_files_of_pickle_formats_are_refused(tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"model{suffix}"
    torch.save({}, file)
    with pytest.raises(ConfigError, match="pickle") as error:
        load_policy(file)
    assert "\n" not in str(error.value)


def test_a_failure_while_saving_leaves_the_previous_checkpoint(tmp_path: Path) -> None:
    folder = tmp_path / step_folder(1)
    save_checkpoint(folder, {"actor": network(1.0)}, card(), {"n": 1})
    with pytest.raises(ConfigError):
        save_checkpoint(folder, {"actor": network(2.0)}, card(), {"n": object()})
    assert load_policy(folder)[0]["actor"]["0.weight"][0, 0] == 1.0
    assert load_training_state(folder) == {"n": 1}
    assert list(tmp_path.iterdir()) == [folder]


def dies_at(call: int, work: Any) -> bool:
    """Runs `work` in a child that dies at its n-th flush or rename; whether it did."""
    child = os.fork()
    if child == 0:
        left = [call]

        def deadly(real: Any) -> Any:
            def wrapper(*arguments: Any) -> None:
                left[0] -= 1
                if left[0] == 0:
                    os._exit(9)
                real(*arguments)

            return wrapper

        code = 1
        try:
            os.fsync, os.replace = deadly(os.fsync), deadly(os.replace)
            work()
            code = 0
        finally:
            os._exit(code)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    assert code in (0, 9)
    return code == 9


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.parametrize("same_name", [False, True])
def test_a_crash_at_any_moment_never_leaves_half_a_checkpoint(tmp_path: Path, same_name: bool) -> None:
    old = tmp_path / step_folder(1)
    new = old if same_name else tmp_path / step_folder(2)

    def save(folder: Path, n: int) -> None:
        save_checkpoint(folder, {"actor": network(n)}, card(), {"n": n})

    def content(folder: Path) -> int:
        n = load_training_state(folder)["n"]
        assert load_policy(folder)[0]["actor"]["0.weight"][0, 0] == n
        return n

    save(old, 1)
    crashes = 0
    while dies_at(crashes + 1, lambda: save(new, 2)):
        crashes += 1
        atomic.recover(tmp_path)
        if same_name:
            assert content(old) in (1, 2)
        else:
            assert content(old) == 1
            assert not new.exists() or content(new) == 2
        assert {p.name for p in tmp_path.iterdir()} <= {old.name, new.name}
    assert crashes > 8
    assert content(new) == 2


def test_leftovers_of_a_crash_are_no_checkpoints_and_are_cleared(tmp_path: Path) -> None:
    leftover = tmp_path / f".{step_folder(1)}.abcd.tmp"
    leftover.mkdir()
    save_policy(leftover / POLICY_FILE, {"actor": network()}, card())
    assert not is_checkpoint(leftover) and list_checkpoints(tmp_path) == []
    save_checkpoint(tmp_path / step_folder(2), {"actor": network()}, card(), {})
    assert [p.name for p in tmp_path.iterdir()] == [step_folder(2)]


def test_keep_last_keeps_the_newest_and_the_best(tmp_path: Path) -> None:
    folders = [tmp_path / step_folder(n) for n in (1, 2, 3, 40, 5)]
    for age, folder in enumerate(folders):
        save_policy(folder / POLICY_FILE, {"actor": network()}, card())
        os.utime(folder, ns=(0, age * 10**9))
    (tmp_path / "notes.txt").touch()
    deleted = keep_last(tmp_path, 2, protect=folders[1])
    # By age and not by number: 5 was written after 40, in a run that was resume_config earlier.
    assert deleted == [folders[0], folders[2]]
    assert list_checkpoints(tmp_path) == [folders[1], folders[3], folders[4]]
    assert (tmp_path / "notes.txt").exists()
    assert keep_last(tmp_path, 1) == [folders[1], folders[3]]
    assert keep_last(tmp_path, 5) == []
    with pytest.raises(ConfigError, match="keep=0"):
        keep_last(tmp_path, 0)


def test_replaced_files_obey_the_umask(tmp_path: Path) -> None:
    plain = tmp_path / "plain"
    plain.touch()
    atomic.write_text(tmp_path / "replaced", "x")
    assert (tmp_path / "replaced").stat().st_mode == plain.stat().st_mode
