from __future__ import annotations

import numpy as np
import onnxruntime
import pytest
import torch
from composed import one_line

from skatemount.exporting.onnx_graph import Values, check_installed, input_shapes, make_graph, output_names, to_bytes
from skatemount.utils.errors import ConfigError


def step(values: Values) -> Values:
    turned = values["axes"].mT @ values["axes"]
    total = values["memory.total"] + torch.sinc(values["angle"])
    return {
        "turned": turned,
        "wave": torch.sinc(values["angle"]),
        "mean": total / (values["memory.count"] + 1),
        "next.total": total,
        "next.count": values["memory.count"] + 1,
    }


EXAMPLE = {
    "axes": torch.arange(9.0).view(1, 3, 3),
    "angle": torch.zeros(1, 3),
    "memory.total": torch.zeros(1, 3),
    "memory.count": torch.zeros(1, 1),
}


def run(model: object, values: Values) -> dict[str, np.ndarray]:
    session = onnxruntime.InferenceSession(to_bytes(model))
    names = [each.name for each in session.get_outputs()]
    given = {each.name: values[each.name].numpy() for each in session.get_inputs()}
    return dict(zip(names, session.run(None, given), strict=True))


def test_a_graph_computes_the_same_also_with_operations_that_the_exporter_lacks() -> None:
    values = EXAMPLE | {"angle": torch.tensor([[0.0, 0.3, -2.0]])}
    results, expected = run(make_graph(step, EXAMPLE), values), step(values)
    assert results.keys() == expected.keys()
    for name, value in results.items():
        np.testing.assert_allclose(value, expected[name].numpy(), atol=1e-6)


@pytest.mark.parametrize(
    ("wanted", "inputs", "outputs"),
    [
        ("turned", ["axes"], ["turned"]),
        ("wave", ["angle"], ["wave"]),
        ("mean", ["angle", "memory.total", "memory.count"], ["mean", "next.count", "next.total"]),
    ],
)
def test_only_what_is_needed_is_kept(wanted: str, inputs: list[str], outputs: list[str]) -> None:
    model = make_graph(step, EXAMPLE, wanted.__eq__)
    assert list(input_shapes(model)) == inputs
    assert sorted(output_names(model)) == sorted(outputs)


def test_an_operation_without_onnx_is_named() -> None:
    with pytest.raises(ConfigError) as error:
        make_graph(lambda values: {"y": torch.special.bessel_j0(values["x"])}, {"x": torch.ones(1)})
    assert "bessel_j0" in one_line(error)


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ConfigError) as error:
        check_installed("format=onnx")
    assert one_line(error) == "format=onnx needs the package onnx: pip install 'skatemount[export]'"
