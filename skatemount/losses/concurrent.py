"""`ConcurrentCritic`: computes the critic on a second thread, beside the rest of a loss."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn

from skatemount.utils.devices import torch_threads

VALUE = "state_value"


class ConcurrentCritic(nn.Module):
    """A critic whose forward and backward passes run on a second thread, within `two_threads`.

    `start` begins the forward pass. The loss, which calls this module as it would call the critic, gets the values when
    it asks for them. As soon as the loss's backward pass has their gradients, the critic's backward pass begins, and
    `join` waits for its end. The results are those of one thread, bit for bit.

    Torch splits each operator over its threads, which then wait for each other. That is slow beside another program
    that needs a core. The two threads here wait for each other once in a minibatch.

    Args:
        critic: Reads ``in_keys`` and writes ``state_value``; see `supports`.
        context: Makes the context in which the critic is computed, because torch keeps modes for each thread.
    """

    def __init__(self, critic: Any, context: Callable[[], contextlib.AbstractContextManager[None]]):
        super().__init__()
        self.critic = critic
        self.in_keys, self.out_keys = critic.in_keys, critic.out_keys
        self._context = context
        self._thread: ThreadPoolExecutor | None = None
        self._started: tuple[TensorDictBase, Future[Tensor]] | None = None
        self._backward: Future[None] | None = None

    @staticmethod
    def supports(actor: Any, critic: Any) -> bool:
        """Return True if a critic writes only values, and shares no parameter with the actor.

        Two threads would add to the gradient of a shared parameter in either order.
        """
        shared = {id(p) for p in actor.parameters()} & {id(p) for p in critic.parameters()}
        return not shared and list(critic.out_keys) == [VALUE]

    @contextlib.contextmanager
    def two_threads(self) -> Iterator[None]:
        """Use the second thread for a ``with`` block; each of the two gets half of torch's threads.

        With one torch thread, or on a GPU, the critic stays on the caller's thread.
        """
        threads = torch.get_num_threads()
        if threads == 1 or any(p.device.type != "cpu" for p in self.critic.parameters()):
            yield
            return
        with torch_threads((threads + 1) // 2), ThreadPoolExecutor(1, "critic") as self._thread:
            try:
                yield
            finally:
                self._thread = self._started = self._backward = None

    def start(self, inputs: TensorDictBase) -> None:
        """Begin the forward pass on some inputs, if there is a second thread."""
        if self._thread is not None:
            inputs = inputs.select(*self.in_keys)
            self._started = inputs, self._thread.submit(self._compute, inputs.copy(), torch.get_num_threads())

    def forward(self, inputs: TensorDictBase) -> TensorDictBase:
        """Write the values of the inputs that `start` got; of other inputs, compute them now."""
        started, self._started = self._started, None
        if started is None or any(inputs[key] is not started[0][key] for key in self.in_keys):
            written: TensorDictBase = self.critic(inputs)
            return written
        value = started[1].result()
        # The loss's backward pass ends at this leaf, and goes on with the actor beside the critic's.
        leaf = value.detach().requires_grad_()

        def begin_backward(leaf: Tensor) -> None:
            assert self._thread is not None
            self._backward = self._thread.submit(value.backward, leaf.grad)

        leaf.register_post_accumulate_grad_hook(begin_backward)
        return inputs.set(VALUE, leaf)

    def join(self) -> None:
        """Wait for the critic's backward pass, and raise the error that ended it, if any."""
        running, self._backward = self._backward, None
        if running is not None:
            running.result()

    def _compute(self, inputs: TensorDictBase, threads: int) -> Tensor:
        torch.set_num_threads(threads)
        with torch.enable_grad(), self._context():
            value: Tensor = self.critic(inputs)[VALUE]
            return value
