"""A device called ``far`` that computes on the CPU and, like a GPU, refuses tensors that are not on it.

Run as a program, it trains, saves, resumes and evaluates on this device with mujoco_warp, and fails if an operation
gets tensors of both devices. It needs a process of its own, because torch keeps the device until the process ends.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest import mock

import torch
import warp as wp
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_flatten, tree_map
from torch.utils.backend_registration import _setup_privateuseone_for_python_backend

_aten = torch.ops.aten
MIXING = (_aten.copy_.default, _aten._to_copy.default)
"""Operations that move tensors between devices."""


class _Module:
    """The functions that torch calls on a device's module."""

    def is_available(self) -> bool:
        return True

    def is_initialized(self) -> bool:
        return True

    def device_count(self) -> int:
        return 1

    def current_device(self) -> int:
        return 0

    def _is_in_bad_fork(self) -> bool:
        return False

    def manual_seed_all(self, seed: int) -> None:
        pass


_setup_privateuseone_for_python_backend("far", backend_module=_Module())
FAR = torch.device("far", 0)


class FarTensor(Tensor):
    """A tensor that claims to be on the device and keeps its data in a CPU tensor."""

    near: Tensor
    __torch_function__ = torch._C._disabled_torch_function_impl

    @staticmethod
    def __new__(cls, near: Tensor) -> FarTensor:
        shape = {"strides": near.stride(), "storage_offset": near.storage_offset(), "dtype": near.dtype}
        made = Tensor._make_wrapper_subclass(cls, near.size(), layout=near.layout, device=FAR, **shape)
        made.near = near
        return made

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return _run(func, args, kwargs or {})

    def __repr__(self, **_: Any) -> str:
        return f"far {self.near}"

    def tolist(self) -> Any:
        return self.near.tolist()


def _run(func: Any, args: Any, kwargs: Any) -> Any:
    given, _ = tree_flatten((args, kwargs))
    tensors = [each for each in given if isinstance(each, Tensor)]
    asked = [each for each in given if isinstance(each, torch.device)]
    is_far = any(isinstance(each, FarTensor) for each in tensors)
    to_far = any(device.type == FAR.type for device in asked)
    if not is_far and not to_far:
        return func(*args, **kwargs)
    moves = func in MIXING or str(func).startswith("aten.to.")
    # Tensors with a single number may be on another device.
    left_behind = [each for each in tensors if not isinstance(each, FarTensor) and each.dim() > 0]
    if is_far and left_behind and not moves:
        shapes = [tuple(each.shape) for each in left_behind]
        raise RuntimeError(f"{func}: got tensors of the device and of the CPU: {shapes}")

    def as_near(value: Any) -> Any:
        if isinstance(value, torch.device):
            return torch.device("cpu")
        return value.near if isinstance(value, FarTensor) else value

    made = func(*tree_map(as_near, args), **tree_map(as_near, kwargs))
    if asked and not to_far:
        return made
    returned, taken = func._schema.returns, func._schema.arguments
    if len(returned) == 1 and returned[0].alias_info is not None and returned[0].alias_info.is_write:
        at = next(i for i, each in enumerate(taken) if each.alias_info is not None and each.alias_info.is_write)
        return args[at] if at < len(args) else kwargs[taken[at].name]
    return tree_map(_as_far, made)


def _as_far(value: Any) -> Any:
    return FarTensor(value) if isinstance(value, Tensor) and not isinstance(value, FarTensor) else value


class _Operations(TorchDispatchMode):
    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return _run(func, args, kwargs or {})


class _Functions(TorchFunctionMode):
    """Functions that make tensors in C++, past the dispatcher."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = dict(kwargs or {})
        device = kwargs.get("device")
        if func in (torch.tensor, torch.as_tensor) and device is not None and torch.device(device).type == FAR.type:
            kwargs["device"] = args[0].device if isinstance(args[0], Tensor) else "cpu"
            return func(*args, **kwargs).to(FAR)
        if func is torch.unravel_index and isinstance(args[0], FarTensor):
            return tuple(FarTensor(each) for each in func(args[0].near, *args[1:], **kwargs))
        return func(*args, **kwargs)


class _Generator(torch.Generator):
    """A generator that claims to be on the device."""

    device = FAR


@contextmanager
def on_the_fake_accelerator() -> Iterator[None]:
    """Use the device in torch, and put mujoco_warp's memory on it, for a ``with`` block."""
    from skatemount.envs.physics import warp

    class Worlds(warp._Worlds):
        def run(self, work: Any) -> None:
            with wp.ScopedDevice("cpu"):
                work()

        def launch(self, substeps: int) -> None:
            self.run(lambda: self._work(substeps))

    to_torch, generator = wp.to_torch, torch.Generator

    def make_generator(device: torch.device | str = "cpu") -> torch.Generator:
        return _Generator() if torch.device(device) == FAR else generator(device)

    of_warp = {
        "to_torch": lambda array: FarTensor(to_torch(array)),
        "device_from_torch": lambda _: wp.get_device("cpu"),
    }
    # Inference tensors lack the version counter that a `FarTensor` needs.
    of_torch = {"Generator": make_generator, "inference_mode": lambda *_: torch.no_grad()}
    with (
        mock.patch.multiple(warp, _Worlds=Worlds, choose_device=lambda name: FAR),
        mock.patch.multiple(wp, **of_warp),
        mock.patch.multiple(torch, **of_torch),
        _Functions(),
        _Operations(),
    ):
        yield


def check_device() -> None:
    """Check that the device computes, and refuses tensors of the CPU."""
    here, there = torch.ones(2), torch.ones(2, device=FAR)
    assert (there + there.to(FAR) + 1.0).device == FAR and (there + there).to("cpu").tolist() == [2.0, 2.0]
    try:
        here + there
    except RuntimeError as error:
        assert "of the CPU: [(2,)]" in str(error)
    else:
        raise AssertionError("tensors of two devices were added")


def train(root: str) -> None:
    """Train with everything that holds tensors, resume, and evaluate the policy."""
    from tiny import TINY

    from skatemount.config import compose
    from skatemount.evaluation.evaluator import Evaluator
    from skatemount.training.trainer import Trainer

    asked = [
        "physics=warp",
        "+curriculum=auto",
        "sensing=hard",
        "sensing.latency=[0,1]",
        "observation=student",
        "algorithm.teacher=pretrained:anywhere",
        "boards=varied",
        "physics.num_worlds=8",
        "collector.steps_per_env=20",
        f"logger.root={root}",
    ]
    config = compose("unfixed", [*TINY, *asked, "total_frames=320", "network.symmetric=true", "network.normalize=true"])
    trainer = Trainer(config)
    trainer.train()
    assert trainer.frames == 320 and next(trainer.networks.parameters()).device == FAR
    trainer.curriculum.draw(trainer.run.curriculum_png, "far")
    config.resume, config.total_frames = str(trainer.run.checkpoint(320)), 480
    trainer.close()
    trainer = Trainer(config)
    trainer.train()
    assert trainer.frames == 480
    # Worlds that have the same board.
    config.boards = compose("unfixed").boards
    evaluator = Evaluator(config, 8, seed=0)
    assert evaluator.run(trainer.networks, 8).episodes == 8
    evaluator.close()
    trainer.close()


if __name__ == "__main__":
    with on_the_fake_accelerator():
        check_device()
        train(sys.argv[1])
