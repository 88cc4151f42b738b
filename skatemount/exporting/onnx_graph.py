"""Export of functions of named tensors as ONNX graphs."""

from __future__ import annotations

import contextlib
import importlib.util
import io
import logging
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from skatemount.utils.errors import ConfigError

OPSET = 17
"""Version of ONNX's operators."""

MEMORY, NEXT = "memory.", "next."
"""Prefixes of a graph's memory: the input ``memory.x`` of a step is the output ``next.x`` of the step before."""

Values = dict[str, Tensor]


class Named(nn.Module):
    """A function of named tensors as a module with positional ones, which the exporter needs.

    Args:
        function: Takes tensors by name and returns tensors by name.
        names: Names of the inputs, in order.

    Attributes:
        outputs: Names of the outputs of the last call, in order.
    """

    def __init__(self, function: Callable[[Values], Values], names: Sequence[str]):
        super().__init__()
        # Parameters of a module inside the function are exported as constants.
        self._function, self._names = function, list(names)
        self.outputs: list[str] = []

    def forward(self, *values: Tensor) -> tuple[Tensor, ...]:
        """Return the function's outputs in order."""
        results = self._function(dict(zip(self._names, values, strict=True)))
        self.outputs = list(results)
        return tuple(results.values())


def check_installed(setting: str) -> None:
    """Raise `ConfigError` if a package that the export needs is missing; ``setting`` names what asked for it."""
    for name in ("onnx", "onnxruntime"):
        if importlib.util.find_spec(name) is None:
            raise ConfigError(f"{setting} needs the package {name}: pip install 'skatemount[export]'")


def make_graph(
    function: Callable[[Values], Values],
    inputs: Values,
    wanted: Callable[[str], bool] = lambda name: True,
    batch: Sequence[str] = (),
) -> Any:
    """Trace a function and return it as an ONNX model.

    What the wanted outputs do not need is left out: other outputs, inputs, and operations. A memory that a wanted
    output needs is an output as well.

    Args:
        function: Takes tensors by name and returns tensors by name. It must not branch on their values.
        inputs: Example inputs by name.
        wanted: Whether an output, by its name, is wanted; those that begin with ``next.`` are chosen by need.
        batch: Names of inputs and outputs whose first dimension may have any size; the others keep theirs.

    Returns:
        The ``onnx.ModelProto``.

    Raises:
        ConfigError: ONNX has no such operation.
    """
    import onnx

    module = Named(function, list(inputs))
    with torch.no_grad():
        module(*inputs.values())
    # The exporter would rename one of the two.
    assert not set(inputs) & set(module.outputs), "an input and an output have the same name"
    buffer = io.BytesIO()
    try:
        with _symbolics(), torch.no_grad():
            torch.onnx.export(
                module,
                tuple(inputs.values()),
                buffer,  # type: ignore[arg-type]  # Files in memory are allowed, too.
                dynamo=False,
                opset_version=OPSET,
                input_names=list(inputs),
                output_names=module.outputs,
                dynamic_axes={name: {0: "batch"} for name in batch},
            )
    except torch.onnx.errors.UnsupportedOperatorError as error:
        raise ConfigError(f"format=onnx: {' '.join(str(error).split())}; use operations that ONNX has") from error
    model = onnx.load_from_string(buffer.getvalue())
    chosen = [name for name in module.outputs if not name.startswith(NEXT) and wanted(name)]
    prune(model.graph, chosen)
    model.producer_name = "skatemount"
    onnx.checker.check_model(model)
    return model


def prune(graph: Any, outputs: Sequence[str]) -> None:
    """Leave out of a graph what some outputs do not need, in place.

    Args:
        graph: The ``onnx.GraphProto``.
        outputs: Names of the outputs to keep; the memory that they need is kept as well.
    """
    makers = {name: i for i, node in enumerate(graph.node) for name in node.output}
    kept, seen, nodes, open_names = list(outputs), set[str](), set[int](), list(outputs)
    while open_names:
        name = open_names.pop()
        if name in seen:
            continue
        seen.add(name)
        if name in makers:
            nodes.add(makers[name])
            open_names += graph.node[makers[name]].input
        elif name.startswith(MEMORY):
            following = NEXT + name.removeprefix(MEMORY)
            kept.append(following)
            open_names.append(following)
    parts = {
        "node": [node for i, node in enumerate(graph.node) if i in nodes],
        "input": [each for each in graph.input if each.name in seen],
        "initializer": [each for each in graph.initializer if each.name in seen],
        "output": sorted((each for each in graph.output if each.name in kept), key=lambda each: kept.index(each.name)),
    }
    for field, values in parts.items():
        copies = [type(value).FromString(value.SerializeToString()) for value in values]
        graph.ClearField(field)
        getattr(graph, field).extend(copies)
    graph.ClearField("value_info")


def input_shapes(model: Any) -> dict[str, list[int]]:
    """Return the shapes of a model's inputs by name, without the first dimension."""
    return {each.name: [d.dim_value for d in each.type.tensor_type.shape.dim][1:] for each in model.graph.input}


def output_names(model: Any) -> list[str]:
    """Return the names of a model's outputs."""
    return [each.name for each in model.graph.output]


def to_bytes(model: Any, metadata: Mapping[str, str] | None = None) -> bytes:
    """Return a model's file.

    Args:
        model: The ``onnx.ModelProto``.
        metadata: Texts by key to keep inside the file.
    """
    model.ClearField("metadata_props")
    for key, value in (metadata or {}).items():
        model.metadata_props.add(key=key, value=value)
    return bytes(model.SerializeToString(deterministic=True))


def metadata_of(file: Path) -> dict[str, str]:
    """Return the texts by key inside a model's file."""
    import onnx

    return {each.key: each.value for each in onnx.load(str(file), load_external_data=False).metadata_props}


@contextlib.contextmanager
def _symbolics() -> Iterator[None]:
    """Teach the exporter operations that it lacks, and keep it from warning, for a ``with`` block."""
    from torch.onnx import symbolic_helper

    def transposed(g: Any, values: Any) -> Any:
        rank: Any = symbolic_helper._get_tensor_rank(values)
        return g.op("Transpose", values, perm_i=[*range(rank - 2), rank - 1, rank - 2])

    def sinc(g: Any, values: Any) -> Any:
        # sin(pi x) / (pi x), and 1 at 0.
        zero, one = (g.op("Constant", value_t=torch.tensor(value)) for value in (0.0, 1.0))
        at_zero = g.op("Equal", values, zero)
        angle = g.op("Mul", values, g.op("Constant", value_t=torch.tensor(torch.pi)))
        divisor = g.op("Where", at_zero, one, angle)
        return g.op("Where", at_zero, one, g.op("Div", g.op("Sin", angle), divisor))

    logger = logging.getLogger("torch.onnx")
    level = logger.level
    for name, symbolic in (("mT", transposed), ("sinc", sinc)):
        torch.onnx.register_custom_op_symbolic(f"aten::{name}", symbolic, OPSET)
    try:
        with warnings.catch_warnings():
            # The tracer warns of every shape that becomes a constant.
            warnings.simplefilter("ignore")
            logger.setLevel(logging.ERROR)
            yield
    finally:
        logger.setLevel(level)
        for name in ("mT", "sinc"):
            torch.onnx.unregister_custom_op_symbolic(f"aten::{name}", OPSET)
