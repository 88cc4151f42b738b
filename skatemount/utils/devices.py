"""Devices, clocks, threads and random states of torch."""

from __future__ import annotations

import contextlib
import functools
import re
import time
from collections.abc import Callable, Iterable, Iterator
from typing import ParamSpec, TypeVar

import torch
from torch import Tensor

from skatemount.utils.errors import ConfigError

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")


def choose_device(name: str) -> torch.device:
    """Return the device that ``physics.device`` names.

    Args:
        name: ``auto`` (a GPU if there is one, else the CPU), or torch's name of a device.

    Raises:
        ConfigError: There is no such device.
    """
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    if not re.fullmatch(r"cpu|cuda(:\d+)?", name):
        raise ConfigError(f"physics.device={name} must be auto, cpu, cuda or cuda:<number>")
    try:
        return torch.zeros(0, device=name).device
    except (RuntimeError, AssertionError) as error:
        raise ConfigError(f"physics.device={name} cannot be used: {str(error).splitlines()[0]}") from error


def seconds(device: torch.device) -> float:
    """Return the time of a steady clock after the device has finished its work, s."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)
    return time.perf_counter()


@contextlib.contextmanager
def torch_threads(number: int | None) -> Iterator[None]:
    """Set torch's number of threads for a ``with`` block; None leaves it unchanged."""
    before = torch.get_num_threads()
    if number is None or number == before:
        yield
        return
    torch.set_num_threads(number)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def on_threads(items: Iterable[T], number: int | None) -> Iterator[T]:
    """Yield items that are computed with some number of torch's threads; the caller's number stays as it is."""
    iterator = iter(items)
    while True:
        with torch_threads(number):
            try:
                item = next(iterator)
            except StopIteration:
                return
        yield item


@contextlib.contextmanager
def full_precision() -> Iterator[None]:
    """Compute matrix products of float32 in full precision for a ``with`` block."""
    before = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision("highest")
    try:
        yield
    finally:
        torch.set_float32_matmul_precision(before)


def plain_defaults(function: Callable[P, R]) -> Callable[P, R]:
    """Run a function with torch's own defaults, float32 on the CPU in full precision, whatever the program has set.

    Some processors round the factors of a matrix product to bfloat16 if the networks' products may be less precise.

    Args:
        function: Any function or method that creates tensors without saying their type and device.
    """

    @functools.wraps(function)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> R:
        dtype, device = torch.get_default_dtype(), torch.get_default_device()
        with full_precision():
            # Checked first because a default device intercepts every call of torch, which costs time.
            if dtype == torch.float32 and device.type == "cpu":
                return function(*args, **kwargs)
            torch.set_default_dtype(torch.float32)
            try:
                with torch.device("cpu"):
                    return function(*args, **kwargs)
            finally:
                torch.set_default_dtype(dtype)

    return wrapped


def rng_state(device: torch.device) -> Tensor:
    """Return the state of torch's default generator on a device, the source of exploration noise."""
    return torch.cuda.get_rng_state(device) if device.type == "cuda" else torch.get_rng_state()


def set_rng_state(state: Tensor, device: torch.device) -> None:
    """Restore a state that `rng_state` returned."""
    if device.type == "cuda":
        torch.cuda.set_rng_state(state, device)
    else:
        torch.set_rng_state(state)
