"""The folder of an exported policy: its card, its graphs, and the check of both."""

from __future__ import annotations

import functools
import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np

FORMAT = 1
"""Layout of the card that this version reads."""

TOLERANCE = 1e-4
"""Largest difference from a test vector, in the unit of the value or as a share of it."""


class RunnerError(ValueError):
    """An error in one line: the folder, the setting or the robot, and what would be right."""


class Graph:
    """A graph with named inputs and outputs, for one robot or one world at a time.

    Args:
        path: The ONNX file.

    Attributes:
        shapes: Shape of each input by name, with the first dimension; that is not a number if it may have any size.
        kinds: Type of each input by name.
        outputs: Names of the outputs.
        metadata: Texts by key inside the file.

    Raises:
        RunnerError: onnxruntime is missing or cannot read the file.
    """

    def __init__(self, path: Path):
        try:
            import onnxruntime
        except ImportError as error:
            raise RunnerError("the package onnxruntime is missing: pip install onnxruntime") from error
        options = onnxruntime.SessionOptions()
        # The networks are small: waking threads would cost more than they save.
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 3
        try:
            self._session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
        except Exception as error:
            raise RunnerError(f"{path}: onnxruntime cannot read it: {' '.join(str(error).split())[:200]}") from error
        given = self._session.get_inputs()
        self.shapes: dict[str, list[Any]] = {each.name: list(each.shape) for each in given}
        self.kinds = {each.name: _KINDS[each.type] for each in given}
        self.outputs = [each.name for each in self._session.get_outputs()]
        self.metadata: dict[str, str] = dict(self._session.get_modelmeta().custom_metadata_map)

    def zeros(self, name: str) -> np.ndarray:
        """Return zeros of an input's shape and type."""
        return np.zeros(self.shapes[name], self.kinds[name])

    def __call__(self, values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return the outputs by name.

        Args:
            values: Inputs by name; what the graph does not need is ignored.
        """
        given = {name: values[name] for name in self.shapes}
        return dict(zip(self.outputs, self._session.run(None, given), strict=True))


_KINDS = {"tensor(float)": np.float32, "tensor(bool)": np.bool_, "tensor(int64)": np.int64}


class PolicyFolder:
    """An exported policy.

    Args:
        path: The folder that `python -m skatemount.export` wrote.

    Attributes:
        path: The folder.
        card: Its card.

    Raises:
        RunnerError: There is no such folder, or a file is missing or damaged.
    """

    def __init__(self, path: Path | str):
        self.path = Path(path)
        file = self.path / "card.json"
        if not file.is_file():
            raise RunnerError(
                f"{path}: has no card.json; give the folder that python -m skatemount.export output=<folder> wrote"
            )
        try:
            self.card: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
        except ValueError as error:
            raise RunnerError(f"{file}: is no JSON ({error}); export the policy again") from error
        if not isinstance(self.card, dict) or self.card.get("format") != FORMAT:
            found = self.card.get("format") if isinstance(self.card, dict) else None
            raise RunnerError(f"{file}: has format {found}, this version reads {FORMAT}; export the policy again")
        if "files" not in self.card:
            raise RunnerError(f"{file}: was exported with format=torch; the runner needs format=onnx")
        for name, digest in self.card["files"].items():
            part = self.path / name
            if not part.resolve().is_relative_to(self.path.resolve()):
                raise RunnerError(f"{file}: file {name} lies outside of the folder")
            if not part.is_file():
                raise RunnerError(f"{part}: is missing; export the policy again")
            if hashlib.sha256(part.read_bytes()).hexdigest() != digest:
                raise RunnerError(f"{part}: differs from the checksum in card.json; export the policy again")

    @property
    def joints(self) -> list[str]:
        """Names of the joints, in the order of actions and targets."""
        return list(self.card["action"]["joints"])

    @property
    def suites(self) -> dict[str, Any]:
        """Suites whose start states the folder has, by name."""
        return dict(self.card["suites"])

    def graph(self, name: str) -> Graph:
        """Return a graph of the folder by its file; it is read once."""
        return self._graphs(name)

    @functools.cached_property
    def _graphs(self) -> Any:
        return functools.cache(lambda name: Graph(self.path / name))

    def arrays(self, name: str) -> dict[str, np.ndarray]:
        """Return the arrays of a ``.npz`` file of the folder."""
        with np.load(self.path / name, allow_pickle=False) as file:
            return {key: file[key] for key in file.files}

    def check(self) -> dict[str, float]:
        """Compare both graphs with the test vectors.

        Returns:
            The largest difference of ``observation``, ``action`` and ``targets``.

        Raises:
            RunnerError: A difference is above `TOLERANCE`.
        """
        vectors = self.arrays("vectors.npz")
        observing, policy = self.graph("observe.onnx"), self.graph("policy.onnx")
        given = {name: vectors[f"observe.{name}"] for name in observing.shapes}
        rows = range(len(vectors["policy.observation"]))
        observations = [
            observing({name: values[i : i + 1] for name, values in given.items()})["observation"] for i in rows
        ]
        computed = {
            "observation": np.concatenate(observations),
            **policy({"observation": vectors["policy.observation"]}),
        }
        largest = {}
        for name in ("observation", "action", "targets"):
            expected = vectors[f"policy.{name}"]
            difference = np.abs(computed[name] - expected)
            largest[name] = float(difference.max())
            if not (difference <= TOLERANCE * np.maximum(1.0, np.abs(expected))).all():
                raise RunnerError(
                    f"{self.path}: {name} differs from the test vectors by {largest[name]:.2g}, more than "
                    f"{TOLERANCE:g}; "
                    "this version of onnxruntime computes something else"
                )
        return largest
