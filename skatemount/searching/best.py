"""Best settings of a search as a YAML file: an experiment, which a training takes by its name."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from skatemount.config.files import groups
from skatemount.config.overrides import read
from skatemount.runs import atomic
from skatemount.runs.sweep import MACHINE, key_of
from skatemount.searching.folder import SearchFolder
from skatemount.searching.space import TRAIN, overrides_of

if TYPE_CHECKING:
    from skatemount.searching.study import SharedStudy

NAME = "best"


def write_best(folder: SearchFolder, study: SharedStudy, record: Mapping[str, Any]) -> Path:
    """Write the settings of a trial as ``best/experiment/best.yaml``, and return the file.

    Args:
        folder: Folder of the search.
        study: Its study.
        record: Record of the trial.
    """
    overrides = [*study.overrides, *overrides_of(record["settings"])]
    rate = f"{record['success']:.1%} of {record['episodes']:,} episodes"
    head = [
        "# @package _global_",
        f"# Best of {len(study.trials())} trials of {folder.path.name}: trial {record['number']}, success in {rate}.",
        f"# {best_command(folder, study.overrides)}",
    ]
    path = folder.path / NAME / "experiment" / f"{NAME}.yaml"
    body = yaml.safe_dump(as_experiment(overrides, folder.pinned), sort_keys=False, allow_unicode=True)
    atomic.write_text(path, "\n".join(head) + "\n" + body)
    return path


def as_experiment(overrides: Sequence[str], pinned: Mapping[str, str]) -> dict[str, Any]:
    """Return overrides as the content of a file of the group ``experiment``.

    Args:
        overrides: In Hydra's form. Those that delete something, and settings of the machine, are left out.
        pinned: Policies that ``latest`` and ``best`` mean.
    """
    defaults: list[Any] = []
    values: dict[str, Any] = {}
    for each in overrides:
        key = key_of(each)
        if each.startswith("~") or key in MACHINE or key.startswith(("hydra.", "hydra/")):
            continue
        value = read(each).value()
        value = str(value) if isinstance(value, str) else value
        if key == "experiment":
            if value is not None:
                defaults.insert(0, value)
        elif key in groups(TRAIN):
            package = each.lstrip("+").partition("=")[0].partition("@")[2]
            defaults.append({f"override /{key}{'@' + package if package else ''}": value})
        else:
            place = values
            *above, last = key.split(".")
            for name in above:
                place = place.setdefault(name, {})
            names_policy = key in ("init_from", "algorithm.teacher") and isinstance(value, str)
            place[last] = pinned.get(str(value), value) if names_policy else value
    return {"defaults": [*defaults, "_self_"], **values}


def best_command(folder: SearchFolder, overrides: Sequence[str] = ()) -> str:
    """Return the command that trains with the best settings.

    Args:
        folder: Folder of the search.
        overrides: Overrides of every training; a file cannot hold those that delete something.
    """
    deleting = [each for each in overrides if each.startswith("~")]
    file, own = folder.path / NAME, folder.config_dir
    train = ["python", "-m", "skatemount.train", "--config-dir", own or str(file), f"experiment={NAME}", *deleting]
    if own is None:
        return shlex.join(train)
    # There can be one folder of settings only.
    copied = ["cp", str(file / "experiment" / f"{NAME}.yaml"), f"{own}/experiment/"]
    return f"mkdir -p {shlex.quote(own)}/experiment && {shlex.join(copied)} && {shlex.join(train)}"
