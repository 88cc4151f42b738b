"""Write what a version of skatemount computes into a folder of plain arrays, for another version to be compared with.

    python tests/golden/dump.py ADAPTER FOLDER PART [PART ...]

ADAPTER is a file such as `adapter.py`. The code it imports is found by PYTHONPATH, so that the same script runs
against any checkout. PARTs are settings, models, steps, updates, policies, episodes, weights.
"""

from __future__ import annotations

import importlib.util
import json
import os
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))
import golden_commands as commands  # noqa: E402
import mujoco  # noqa: E402
import numpy as np  # noqa: E402
import safetensors.numpy  # noqa: E402

import skatemount  # noqa: E402, F401  # Before numpy and torch, as its own programs do: it sets how torch's threads wait.

STEP_WORLDS = 8
POLICY_STATES = 64
GIVEN = Path(__file__).parent / "data"


def load_adapter(path: Path) -> Any:
    """Return an adapter, a module of functions, from its file."""
    spec = importlib.util.spec_from_file_location("golden_adapter", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def model_fields(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    """Return every number of a compiled model by its field's name, those of its options with ``opt.`` before."""
    fields: dict[str, np.ndarray] = {}
    for prefix, part in (("", model), ("opt.", model.opt), ("stat.", model.stat)):
        for name in dir(part):
            value = None if name.startswith("_") else getattr(part, name)
            if isinstance(value, np.ndarray | int | float) and not isinstance(value, bool):
                fields[prefix + name] = np.array(value)
    fields["names"] = np.frombuffer(model.names, dtype=np.uint8)
    return fields


def settings(adapter: Any, out: Path) -> None:
    """Write the composed settings of every documented command, and those in which suites evaluate."""
    document = {
        "trainings": {line: adapter.settings(line) for line in commands.TRAININGS},
        "suites": {
            f"{policy} {suite}": adapter.suite_settings(suite, policy)
            for policy in ("best", "balance")
            for suite in commands.SUITES
        },
    }
    text = json.dumps(document, indent=0, sort_keys=True) + "\n"
    (out / "settings.json").write_text(text, encoding="utf-8")


def models(adapter: Any, out: Path) -> None:
    """Write all fields of the compiled models."""
    for name, line in commands.MODELS.items():
        np.savez_compressed(out / f"model_{name}.npz", **model_fields(adapter.compiled_model(line)))


def steps(adapter: Any, out: Path) -> None:
    """Write start states and what one control step makes of them; stored start states are used again."""
    for name, line in commands.STEPS.items():
        stored = GIVEN / f"step_{name}.npz"
        given = _given(stored, ("start.", "action")) if stored.exists() else adapter.draw_step(line, STEP_WORLDS)
        np.savez_compressed(out / f"step_{name}.npz", **given, **_under("made.", adapter.control_step(line, given)))


def updates(adapter: Any, out: Path) -> None:
    """Write a batch and what one update makes of the weights; a stored batch is used again."""
    for name, line in commands.UPDATES.items():
        stored = GIVEN / f"update_{name}.npz"
        given = _given(stored, ("batch.", "before.")) if stored.exists() else adapter.draw_update(line)
        np.savez_compressed(out / f"update_{name}.npz", **given, **_under("made.", adapter.update(line, given)))


def policies(adapter: Any, out: Path) -> None:
    """Write the deterministic actions of the shipped policies, and of an old run's, for random observations."""
    specs = {name: f"pretrained:{name}" for name in commands.POLICIES} | {"old_run": str(GIVEN / "old_run")}
    made = {}
    for name, spec in specs.items():
        shape = (POLICY_STATES, adapter.policy_size(spec))
        observation = np.random.default_rng(7).normal(size=shape).astype(np.float32)
        made[name] = adapter.policy_actions(spec, observation)
    np.savez_compressed(out / "policies.npz", **made)


def episodes(adapter: Any, out: Path) -> None:
    """Write the records of the first episodes of each suite with `pretrained:best`."""
    for suite in commands.SUITES:
        records, ends = adapter.episodes(suite, commands.EPISODES)
        np.savez_compressed(out / f"episodes_{suite}.npz", **records, ends=np.array(ends))


def weights(adapter: Any, out: Path) -> None:
    """Write the weights that short trainings end with, by the command line alone."""
    for name, line in commands.WEIGHTS.items():
        root = out / "runs" / name
        train(getattr(adapter, "training_line", str)(line), root)
        made = {}
        for file in sorted(root.rglob("policy.safetensors")):
            part = file.relative_to(root).parts[2]
            stage = part if name == "paper" else name
            steps_trained = int(file.parent.name.removeprefix("step_"))
            found = getattr(adapter, "saved_weights", dict)(safetensors.numpy.load_file(file))
            made |= {f"{stage}/{steps_trained}/{key}": value for key, value in found.items()}
        np.savez_compressed(out / f"weights_{name}.npz", **made)


def train(line: str, root: Path) -> str:
    """Run a training in a process of its own, and return what it printed."""
    command = [sys.executable, "-m", "skatemount.train", *shlex.split(line), f"logger.root={root}"]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | {"MUJOCO_GL": "disable"})
    if done.returncode:
        raise SystemExit(f"{shlex.join(command)}\n{done.stdout}\n{done.stderr}")
    return done.stdout


def _given(file: Path, prefixes: tuple[str, ...]) -> dict[str, np.ndarray]:
    with np.load(file) as stored:
        return {name: stored[name] for name in stored.files if name.startswith(prefixes)}


def _under(prefix: str, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {prefix + name: value for name, value in arrays.items()}


PARTS = {f.__name__: f for f in (settings, models, steps, updates, policies, episodes, weights)}


def main() -> None:
    """Write the parts that the command line names."""
    adapter_file, out, names = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:]
    out.mkdir(parents=True, exist_ok=True)
    import torch

    torch.set_num_threads(1)
    adapter = load_adapter(adapter_file)
    for name in names:
        PARTS[name](adapter, out)
        print(f"{name}: written", flush=True)


if __name__ == "__main__":
    main()
