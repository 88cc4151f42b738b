"""`Teacher`: a trained policy that says what it would do in the states of another policy's training."""

from __future__ import annotations

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from skatemount.agents.interface import check_actions, feature_indices, observation_layout
from skatemount.agents.trained_policy import TrainedPolicy
from skatemount.envs import MountTask
from skatemount.utils.errors import ConfigError


class Teacher:
    """A policy that reads a training's ``privileged`` instead of the observation that it was trained with.

    The observation ``privileged`` has no errors of sensors, but only the present frame. A teacher that was trained
    with several frames gets the earlier ones from the steps of the batch.

    Args:
        agent: The policy, on the device of the batches.
        task: Task of the training.
        where: Setting that names the policy, for messages.

    Raises:
        ConfigError: The policy has memory, or the task lacks a part of its observation; the message names it.
    """

    def __init__(self, agent: TrainedPolicy, task: MountTask, where: str):
        check_actions(agent.card, task, where)
        if agent.networks.recurrent:
            raise ConfigError(f"{where}: it has memory (network.kind={agent.config.network.kind}); use one without")
        self._actor = agent.networks.actor
        entries = [entry for entry in agent.card.observation if entry["key"] == "observation"]
        self._frames = max(entry.get("history_length", 1) for entry in entries)
        # What the policy read as its observation has to be among the truth, one frame of each term.
        single = [
            {**entry, "key": "privileged", "size": entry["size"] // entry.get("history_length", 1), "history_length": 1}
            for entry in entries
        ]
        layout, giver = observation_layout(task), "observation.privileged of this run"
        try:
            columns = feature_indices(layout, single, "privileged", where, giver)
        except ConfigError as error:
            advice = "give it to the critic, as observation=student does, or use no teacher"
            raise ConfigError(f"{error}; {advice}") from error
        # An input is a column of a frame of some age. The oldest frame of a term comes first.
        inputs, ages = [], []
        for part, entry in zip(columns.split([each["size"] for each in single]), entries):
            for age in reversed(range(entry.get("history_length", 1))):
                inputs.append(part)
                ages.append(torch.full_like(part, age))
        device = next(self._actor.parameters()).device
        self._columns, self._ages = torch.cat(inputs).to(device), torch.cat(ages).to(device)

    @torch.no_grad()
    def __call__(self, batch: TensorDictBase) -> Tensor:
        """Return the mean actions of the teacher.

        Args:
            batch: ``[N, T]`` as a collector yields it.

        Returns:
            ``[N, T, J]``; nan at the steps at the beginning of the batch whose earlier frames are not in it.
        """
        present = batch["privileged"]
        begins = torch.ones(present.shape[:2], dtype=torch.bool, device=present.device)
        begins[:, 1:] = batch["next", "done"][:, :-1, 0]
        frame, known = present, torch.ones_like(begins)
        begins[:, 0] = False
        inputs = present.new_empty(*present.shape[:2], len(self._columns))
        for age in range(self._frames):
            if age:
                # At the beginning of an episode its first frame stands for those before.
                frame = torch.where(begins.unsqueeze(-1), present, frame.roll(1, 1))
                known = known.roll(1, 1)
                known[:, 0] = False
                known = known | begins
            rows = self._ages == age
            inputs[..., rows] = frame[..., self._columns[rows]]
        observation = TensorDict({"observation": inputs}, batch.batch_size)
        means = self._actor.get_dist(observation).base_dist.loc
        return torch.where(known.unsqueeze(-1), means, torch.nan)
