"""A chain of stages: each stage starts from the policy of the stage before it.

A chain is one run folder with a part for each stage (`1_gait`, `2_balance`, …). Its state is read from the parts'
checkpoints alone, so that it can resume wherever it was stopped; `stages.json` is a report for readers.
"""

from __future__ import annotations

import copy
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from skatemount import config as configuration
from skatemount.config import TrainConfig
from skatemount.config.files import choices
from skatemount.curriculum.config import StageLink
from skatemount.evaluation import report
from skatemount.runs import atomic
from skatemount.runs.checkpoint import load_training_state, read_card
from skatemount.runs.find import find_checkpoint, is_own_run
from skatemount.runs.folder import RunFolder
from skatemount.runs.serialization import parse_json
from skatemount.runs.sweep import SweepFolder, key_of
from skatemount.training.callbacks import Callback, gate_reached
from skatemount.training.commands import naming_what_is_left
from skatemount.training.plots import plot_chain
from skatemount.training.resume import apply_resume_overrides
from skatemount.training.score import save_evaluation
from skatemount.training.trainer import Trainer
from skatemount.utils.decoration import Decoration
from skatemount.utils.documents import read_yaml
from skatemount.utils.errors import ConfigError
from skatemount.utils.formatting import format_count
from skatemount.utils.signals import ending_by_signals

CONFIGS_FILE = "stages.yaml"
REPORT_FILE = "stages.json"


@dataclass
class Part:
    """A stage of a chain.

    Attributes:
        name: The stage's name.
        folder: The folder of its run, which may not exist yet.
        link: Its gate and budget.
        config: Its settings, except the budget and the initial policy, which follow from the stages before.
    """

    name: str
    folder: Path
    link: StageLink
    config: TrainConfig

    @property
    def latest(self) -> Path | None:
        """Its newest checkpoint, if it has one."""
        return RunFolder(self.folder).latest

    @property
    def frames(self) -> int:
        """Environment steps trained."""
        return 0 if self.latest is None else read_card(self.latest).frames

    def ended(self, budget: int) -> str | None:
        """Return what ended it, ``gate`` or ``budget``; None while it needs more training.

        Args:
            budget: Its environment steps.
        """
        if self.latest is None:
            return None
        card = read_card(self.latest)
        if gate_reached(self.link.gate, card.metrics):
            return "gate"
        return "budget" if card.frames >= budget else None


class Chain:
    """Trains the stages of a chain in order.

    Args:
        run: The chain's run folder.
        config: The chain's settings; its ``total_frames`` is for all stages together.
        stages: The settings of every stage.
        overrides: The overrides of the command line, which the run folders keep.
        callbacks: As for `Trainer`; every stage's training calls them.
    """

    def __init__(
        self,
        run: RunFolder,
        config: TrainConfig,
        stages: dict[str, TrainConfig],
        overrides: list[str],
        callbacks: Sequence[Callback] = (),
    ):
        self.run = run
        self.callbacks = callbacks
        self.config = config
        self._overrides = overrides
        self.parts = [
            Part(name, run.path / f"{i}_{name}", config.curriculum.stages[name], stages[name])
            for i, name in enumerate(stages, 1)
        ]
        self._evaluated: dict[str, dict[str, Any]] = {}
        self._reported = Decoration("the report of the stages")
        self._drawn = Decoration("the picture of the learning curves")
        self._shown = Decoration("the table of the evaluation")

    @classmethod
    def begin(
        cls,
        config: TrainConfig,
        overrides: list[str],
        callbacks: Sequence[Callback] = (),
        sweep: SweepFolder | None = None,
    ) -> Chain:
        """Compose the settings of every stage, and create the run folder.

        Args:
            config: As composed from the command line, with ``+curriculum=<a chain>``.
            overrides: The overrides of the command line; all but the curriculum's own apply to every stage.
            callbacks: As for `Chain`.
            sweep: The sweep that the run belongs to, if any; its folder there is named ``logger.name``.

        Raises:
            ConfigError: A setting that cannot be used in one of the stages.
        """
        stages = compose_stages(config, overrides)
        for i, (name, link) in enumerate(config.curriculum.stages.items(), 1):
            stages[name].stage.gate, stages[name].stage.renormalize = link.gate, link.renormalize
            stages[name].logger.name = f"{i}_{name}"
        logger = config.logger
        name, values = logger.name or config.curriculum.name, configuration.to_dict(config)
        if sweep is None:
            run = RunFolder.create(logger.root, logger.experiment, name, values, overrides)
        else:
            run = sweep.create_part(name, values, overrides)
        saved = {name: configuration.to_dict(stage) for name, stage in stages.items()}
        # Settings files may change before the chain is through.
        atomic.write_text(run.path / CONFIGS_FILE, yaml.safe_dump(saved, sort_keys=False, allow_unicode=True))
        return cls(run, config, stages, overrides, callbacks)

    @classmethod
    def resume(
        cls, run: RunFolder, config: TrainConfig, overrides: list[str], callbacks: Sequence[Callback] = ()
    ) -> Chain:
        """Open a chain that was stopped.

        Args:
            run: The chain's run folder.
            config: As composed from the command line.
            overrides: The overrides of the command line.
            callbacks: As for `Chain`.

        Raises:
            ConfigError: An override that cannot be changed in the middle of a run.
        """
        own, where = is_own_run(run.path, config.logger.root), f"resume={config.resume}: saved settings"
        saved = configuration.from_dict(run.config, own=own, where=where, training=True)
        path = run.path / CONFIGS_FILE
        values = read_yaml(path)
        if list(values) != list(saved.curriculum.stages) or not all(isinstance(each, dict) for each in values.values()):
            raise ConfigError(f"{path}: must hold the settings of {', '.join(saved.curriculum.stages)}, in this order")
        stages = {name: configuration.from_dict(stage, own, where, training=True) for name, stage in values.items()}
        apply_resume_overrides(saved, config, overrides)
        for stage in stages.values():
            apply_resume_overrides(stage, config, [o for o in overrides if not _about_the_curriculum(o)])
        return cls(run, saved, stages, overrides, callbacks)

    def budget(self, place: int) -> int:
        """Return a stage's environment steps: its share, among the stages to come, of what the earlier ones left.

        Args:
            place: The stage's place in the chain, from 0.
        """
        left = self.config.total_frames - sum(part.frames for part in self.parts[:place])
        shares = [part.link.budget for part in self.parts[place:]]
        # At least one iteration, although the stages before, which end at whole batches, may have left nothing.
        return max(1, round(left * shares[0] / sum(shares)))

    def ended(self, place: int) -> str | None:
        """Return what ended a stage, ``gate`` or ``budget``; None if it has not started or needs more training.

        Args:
            place: The stage's place in the chain, from 0.
        """
        part = self.parts[place]
        if any(later.latest is not None for later in self.parts[place + 1 :]):
            # A larger budget does not reopen it.
            return part.ended(0)
        return part.ended(self.budget(place))

    def train(self) -> None:
        """Train the stages that have not ended.

        Raises:
            ConfigError: Nothing is left, or another process is training the chain.
        """
        left = [place for place in range(len(self.parts)) if self.ended(place) is None]
        if not left:
            raise ConfigError(
                f"total_frames={self.config.total_frames}: all stages of {self.run.path} have ended; raise "
                "total_frames to train the last one further"
            )
        try:
            with self.run.lock(), ending_by_signals():
                try:
                    for place in left:
                        self._train(place)
                finally:
                    self.report()
        except BaseException:
            if self.run.latest is None and len(left) == len(self.parts):
                self.run.remove_unused()
            raise

    def _train(self, place: int) -> None:
        part, total = self.parts[place], len(self.parts)
        config = copy.deepcopy(part.config)
        config.total_frames = self.budget(place)
        latest = part.latest
        if latest is not None:
            config.resume = str(latest)
        else:
            if part.folder.exists():
                # It was stopped before its first checkpoint.
                atomic.remove_folder(part.folder)
            config.init_from = self._start(place)
        end = f"after {format_count(config.total_frames)} steps"
        if part.link.gate is not None:
            end = f"at an evaluated success of {part.link.gate:.0%}, or {end}"
        print(f"stage {place + 1} of {total}, {part.name}: {config.stage.description}; it ends {end}")
        trainer = Trainer(config, self._overrides, self.run, self.callbacks)
        print(trainer.describe(), flush=True)
        self.report()
        try:
            result = trainer.train()
        finally:
            trainer.close()
        if result is not None:
            with naming_what_is_left(trainer):
                save_evaluation(trainer.run, result, trainer.frames)
            self._evaluated[part.name] = {
                "episodes": result.episodes,
                **result.to_dict(failed_episodes=False)["success"],
            }
            with self._shown:
                print(report.table(result), flush=True)
        self.report()

    def _start(self, place: int) -> str | None:
        """Return the initial policy: the stage before; for the first stage the one that the user names, or none."""
        if place:
            return str(self.parts[place - 1].folder)
        spec = self.config.init_from
        return None if spec == "stage" else spec

    def report(self) -> None:
        """Write what became of each stage so far, and draw the learning curves of all stages."""
        # They are for readers: a chain resumes without them.
        with self._reported:
            self._write_report()
        tables = [(part.name, RunFolder(part.folder).metrics_file) for part in self.parts]
        # A table is there from a stage's first iteration on.
        with self._drawn:
            if self.config.logger.jsonl and any(part.frames for part in self.parts):
                plot_chain(tables, self.run.curves_png, self.run.path.name)

    def _write_report(self) -> None:
        path = self.run.path / REPORT_FILE
        if path.is_file():
            known = {s["name"]: s["evaluated"] for s in parse_json(path.read_bytes(), path)["stages"]}
            self._evaluated = known | self._evaluated
        stages = []
        for place, part in enumerate(self.parts):
            entry: dict[str, Any] = {"name": part.name, "folder": part.folder.name, "gate": part.link.gate}
            if part.folder.exists():
                latest, run = part.latest, RunFolder(part.folder)
                card = None if latest is None else read_card(latest)
                entry |= {
                    "starts_from": run.config["init_from"],
                    "budget": self.budget(place),
                    "frames": 0 if card is None else card.frames,
                    "seconds": 0.0 if latest is None else round(load_training_state(latest)["progress"]["elapsed"], 1),
                    "success": None if card is None else card.metrics.get("Evaluation/success"),
                    "ended": self.ended(place),
                }
            entry["evaluated"] = self._evaluated.get(part.name)
            stages.append(entry)
        document = {"total_frames": self.config.total_frames, "stages": stages}
        atomic.write_text(path, json.dumps(document, indent=2, allow_nan=False) + "\n")


def chain_to_train(
    config: TrainConfig,
    overrides: Sequence[str],
    callbacks: Sequence[Callback] = (),
    sweep: SweepFolder | None = None,
) -> Chain | None:
    """Return the chain that the command line asks for, new or resumed; None if it asks for a single stage.

    Args:
        config: As composed from the command line.
        overrides: The overrides of the command line.
        callbacks: As for `Chain`.
        sweep: As for `Chain.begin`.

    Raises:
        ConfigError: A setting that cannot be used, or a checkpoint from which a chain cannot resume.
    """
    if config.resume is None:
        if config.curriculum.kind != "stages":
            return None
        return Chain.begin(config, list(overrides), callbacks, sweep)
    found = find_checkpoint(config.resume, Path(config.logger.root), setting="resume")
    run = RunFolder.open(found, setting="resume")
    if run.parent is None:
        return None
    latest = run.parent.latest
    if latest is None or found.resolve() != latest.resolve():
        raise ConfigError(
            f"resume={config.resume}: a checkpoint within the chain of stages {run.parent.path}, which resumes from "
            f"its newest checkpoint only: resume={run.parent.path}"
        )
    return Chain.resume(run.parent, config, list(overrides), callbacks)


def compose_stages(config: TrainConfig, overrides: Sequence[str]) -> dict[str, TrainConfig]:
    """Return the settings of every stage of a chain, by its name.

    Args:
        config: As composed from the command line.
        overrides: The overrides of the command line; all but the curriculum's own apply to every stage.

    Raises:
        ConfigError: A setting that cannot be used in one of the stages.
    """
    asked = [o for o in overrides if not _about_the_curriculum(o)]
    return {name: _compose_link(name, link, asked) for name, link in config.curriculum.stages.items()}


def _compose_link(name: str, link: StageLink, asked: Sequence[str]) -> TrainConfig:
    """Return the settings of one stage of a chain, in which the command line overrides the list of the chain."""
    # A stage's own file may choose a curriculum, but the chain decides where its stages begin.
    chosen = any(key_of(each) == "curriculum" for each in link.settings)
    settings = link.settings if chosen else ["curriculum=none", *link.settings]
    try:
        return configuration.compose(name, [*settings, *asked])
    except ConfigError as error:
        if not link.settings:
            raise
        raise ConfigError(f"curriculum.stages.{name}.settings={link.settings}: {error}") from error


def check_stages(config: TrainConfig, overrides: Sequence[str]) -> None:
    """Check that the settings of a training name a stage, or a chain whose stages can be composed.

    Args:
        config: As composed from the command line.
        overrides: The overrides of the command line.

    Raises:
        ConfigError: They do not, or a setting cannot be used in one of the stages.
    """
    if config.resume is not None:
        return
    if config.curriculum.kind == "stages":
        compose_stages(config, overrides)
    elif not config.stage.name:
        known = ", ".join(choices("stage"))
        raise ConfigError(
            f"no stage: give stage=<name>, one of {known} (skatemount list stages describes them), or curriculum=paper"
        )


def _about_the_curriculum(override: str) -> bool:
    key = key_of(override)
    return key == "curriculum" or key.startswith("curriculum.")
