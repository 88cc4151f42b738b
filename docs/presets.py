"""Reference pages of what can be chosen: robots, boards, commands, stages, suites, policies, and classes."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import reference as ref
from reference import CONF, ROOT, code, comment, head, option, options, plain, raw, row


def group_page(title: str, intro: str, group: str) -> str:
    """Return a page of the options of a group: what each is, and how it differs from the default."""
    default = ref.chosen().get(group, options(group)[0])
    base = option(group, default)
    known = ref.meanings(ref.groups()[group], group) if group in ref.groups() else {}
    lines = [f"# {title}", "", intro, ""]
    for name in [default, *(each for each in options(group) if each != default)]:
        lines += [f"## `{group}={name}`", "", plain(comment(CONF / group / f"{name}.yaml")), ""]
        values = option(group, name)
        if name == default:
            lines += [f"The default. [Settings](settings.md#{group}) has the meaning of each value.", ""]
            shown = values
        else:
            shown = {key: value for key, value in values.items() if value != base.get(key)}
        lines += head("setting", "value", "meaning")
        for key, value in shown.items():
            lines.append(row(f"`{group}.{key}`", code(value), plain(known.get(key, ("", ""))[1])))
        lines.append("")
    return "\n".join(lines)


def command_page() -> str:
    """Return the page of the command modes."""
    modes = getattr(__import__("skatemount.envs.config.commands", fromlist=["MODES"]), "MODES", ())
    intro = (
        "A velocity command has three values: forward and left, m/s, and turn left, rad/s. "
        f"`command.mode` says where it comes from: {', '.join(f'`{mode}`' for mode in modes)}. "
        "`command=<option>` chooses a file with a mode and its ranges."
    )
    return group_page("Commands", intro, "command")


def tasks_page() -> str:
    """Return the page of the tasks: criterion, failure, metrics, score, and the settings that belong to each."""
    from skatemount.envs.tasks import TASKS

    counts = {"all": "all", "complete": "that lasted until the time limit", "success": "that succeeded"}
    lines = [
        "# Tasks",
        "",
        "A task says what an episode is about. `task=<name>` chooses one for a training, with the settings that belong "
        "to it; stages and suites choose theirs. `success=<name>` chooses criterion and metrics alone. [Use your own]"
        "(../tutorials/own_task.md) says how to write one.",
        "",
    ]
    for name in TASKS.names():
        task = TASKS.get(name)
        lines += [f"## `task={name}`", "", sentence(task.description), "", "**Success.**"]
        lines += [" ".join(map(plain, ref.Docstring.of(task.success).paragraphs)), ""]
        lines += ["An episode must also last until its time limit.", ""]
        lines += [f"**Failure at the time limit.** `{task.failure}`: {plain(task.failure_words)}.", ""]
        lines += head("metric", "label", "unit", "over the episodes", "episodes", "meaning")
        for each in task.metrics:
            counted = counts[each.counts]
            if each.otherwise == each.otherwise:
                counted = f"all; {each.otherwise:g} unless it is one {counted}"
            cells = (each.label, each.unit, each.reducer, counted, plain(each.meaning))
            lines.append(row(f"`{each.name}`", *cells))
        terms = "".join(f" {'-' if w < 0 else '+'} {abs(w):g} × `{metric}`" for metric, w in task.score.items())
        lines += ["", f"**Score for the best checkpoint.** success rate{terms}", "", "**Settings.**", ""]
        values = raw(CONF / "task" / f"{name}.yaml")
        lines += defaults_of(values, "task")
        lines += [f"- `{key}={value}`" for key, value in flat(values)]
        lines += ["", f"Source: {{py:mod}}`{TASKS.module(name)}`.", ""]
    return "\n".join(lines)


def defaults_of(values: dict[str, Any], group: str) -> list[str]:
    """Take the defaults list from the values of a file, and return a line for each entry."""
    lines = []
    for entry in values.pop("defaults", []):
        if isinstance(entry, dict):
            lines += [f"- `{str(other).removeprefix('override /')}={each}`" for other, each in entry.items()]
        elif entry != "_self_":
            lines.append(f"- builds on `{group}={entry}`")
    return lines


def stages_page() -> str:
    """Return the page of the stages: the settings that each changes."""
    lines = ["# Stages", "", "What each stage sets, from its file. [Stages](../stages.md) explains them.", ""]
    for name in options("stage"):
        values = raw(CONF / "stage" / f"{name}.yaml")
        about: Any = values.pop("stage", {})
        lines += [f"## `stage={name}`", "", sentence(str(about.get("description", ""))), ""]
        lines += defaults_of(values, "stage")
        lines.append(f"- initial policy: {code(about.get('init_from')) if about.get('init_from') else 'from scratch'}")
        lines += [f"- `{key}={value}`" for key, value in flat(values)]
        lines.append("")
    return "\n".join(lines)


def suites_page() -> str:
    """Return the page of the suites: stage, changes, variants, seed, and version."""
    lines = ["# Suites", "", "What each suite of [MountBench](../mountbench.md) tests, from its file.", ""]
    for name in options("suite"):
        values = raw(CONF / "suite" / f"{name}.yaml")
        lines += [f"## `suite={name}`", "", sentence(str(values["description"])), ""]
        lines.append(f"- version {values['version']}")
        if "stage" in values:
            lines += [f"- task of `stage={values['stage']}`", f"- seed {values['seed']}"]
        if "ladder" in values:
            unit = f" ({values['unit']})" if "unit" in values else ""
            lines.append(f"- its variants are a ladder: {values['ladder']}{unit}")
        if "members" in values:
            lines.append(f"- suites: {', '.join(f'`{each}`' for each in values['members'])}")
        lines += [f"- `{override}`" for override in values.get("overrides", [])]
        lines += [
            f"- variant *{each}*: {', '.join(map(code, said))}" for each, said in values.get("variants", {}).items()
        ]
        lines.append("")
    return "\n".join(lines)


def policies_page() -> str:
    """Return the page of the shipped policies, from their cards."""
    lines = ["# Policies", "", "The policies in the package, from their cards. `pretrained:<name>` names one.", ""]
    lines += head("name", "stage", "frames", "observation", "actor", "sha256")
    notes: list[str] = []
    for path in sorted((ROOT / "skatemount" / "policies").glob("*.json")):
        card = json.loads(path.read_text(encoding="utf-8"))
        size = sum(part["size"] for part in card["observation"] if part["key"] == "observation")
        layers = "-".join(map(str, card["config"]["network"]["actor"]))
        frames = f"{card['frames']:,}"
        lines.append(
            row(f"`{path.stem}`", f"`{card['stage']}`", frames, f"{size} values", layers, f"`{card['sha256'][:12]}`")
        )
        notes += [f"## `pretrained:{path.stem}`", "", plain(card["notes"].split(" Failures in ")[0]), ""]
    return "\n".join([*lines, "", *notes])


def classes_page() -> str:
    """Return the page of the classes that settings name, with their parameters."""
    from skatemount.config.registries import POLICY_CLASSES, TRAINING_CLASSES

    lines = [
        "# Classes",
        "",
        "The classes that settings name. [Use your own](../extend.md) says how to write another one.",
        "",
    ]
    for setting, registry in (POLICY_CLASSES | TRAINING_CLASSES).items():
        if not registry.names():
            continue
        lines += [f"## `{setting}`", "", *head("name", "class", "meaning")]
        for name in registry.names():
            cls = registry.find(name, setting)
            where = f"{cls.__module__}.{cls.__name__}"
            lines.append(row(f"`{name}`", f"`{where}`", plain(registry.description(name))))
        lines.append("")
    return "\n".join(lines)


def inputs_page() -> str:
    """Return the page of what every term has in common: its inputs, its row in the settings, its mirror image."""
    from skatemount.envs.config.terms import ObservationTerm, RewardTerm, TerminationTerm
    from skatemount.envs.mirror import KINDS
    from skatemount.envs.state import EpisodeState, SimState
    from skatemount.envs.terms import TaskContext

    lines = [
        "# Inputs and settings of terms",
        "",
        "What each reward, observation and termination gets, and what its row in the settings can set. "
        "[Use your own](../tutorials/own_reward.md) says how to write one. N is the number of "
        "worlds; J, F and B are the robot's joints, feet and bodies. The A1 has 12, 4 and 13.",
        "",
    ]
    for title, cls in (("sim", SimState), ("episode", EpisodeState), ("context", TaskContext)):
        docstring = ref.Docstring.of(cls)
        lines += [f"## `{title}`", "", plain(" ".join(docstring.paragraphs)), ""]
        lines += head("field", "shape", "meaning, frame and unit")
        for name, text in docstring.entries.items():
            shape, rest = re.fullmatch(r"(?:``(\[.*?\])``,? )?(.*)", text, re.DOTALL).groups()
            lines.append(row(f"`{title}.{name}`", f"`{shape}`" if shape else "", plain(rest)))
        lines.append("")
    rows = {"observation.policy": ObservationTerm, "reward": RewardTerm, "termination": TerminationTerm}
    for table, cls in rows.items():
        lines += [f"## `{table}.<term>`", "", *head("setting", "default", "meaning")]
        made = cls()
        for name, (_, text) in ref.meanings(cls).items():
            lines.append(row(f"`{name}`", code(getattr(made, name)), plain(text)))
        lines.append("")
    lines += ["The rows of `observation.privileged` have the settings of `observation.policy`.", ""]
    lines += ["## Kinds of mirror images", "", *head("kind", "for")]
    lines += [row(f"`{kind}`", plain(meaning)) for kind, meaning in KINDS.items()]
    return "\n".join([*lines, ""])


def sentence(text: str) -> str:
    """Return a description as a sentence."""
    return f"{plain(text[:1].upper() + text[1:])}."


def flat(values: dict[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    """Return nested settings as pairs of full name and value."""
    found: list[tuple[str, Any]] = []
    for key, value in values.items():
        if isinstance(value, dict) and value:
            found += flat(value, f"{prefix}{key}.")
        else:
            found.append((f"{prefix}{key}", json.dumps(value) if not isinstance(value, str) else value))
    return found


def pages() -> dict[str, tuple[str, str]]:
    """Return title and text of every page, by file name."""
    from skatemount.envs.observations import OBSERVATIONS
    from skatemount.envs.rewards import REWARDS
    from skatemount.envs.terminations import TERMINATIONS

    rewards = (
        "Every reward term. A table in `conf/reward/` gives weights; a weight is 0 or more. `reward.<term>.weight` "
        "changes one, `reward.<term>.params.<name>` a parameter."
    )
    observations = (
        "Every observation term. A table in `conf/observation/` lists what the actor sees (`policy`) and what only the "
        "critic sees (`privileged`). Noise is added first, then comes the clip, then the scale."
    )
    terminations = "Every condition that can end an episode early. `termination.<term>.enabled=false` switches one off."
    made = {
        "settings": ref.settings_page(),
        "rewards": ref.terms_page("Rewards", rewards, REWARDS, "reward", ref.reward_kind),
        "observations": ref.terms_page("Observations", observations, OBSERVATIONS, "observation", ref.observation_kind),
        "terminations": ref.terms_page(
            "Terminations", terminations, TERMINATIONS, "termination", lambda *_: "termination"
        ),
        "inputs": inputs_page(),
        "commands": command_page(),
        "robots": group_page("Robots", "`robot=<name>` chooses the robot.", "robot"),
        "boards": group_page("Boards", "`board=<name>` chooses the skateboard.", "board"),
        "varied_boards": group_page(
            "Boards that vary", "`boards=<name>` chooses [the boards of the worlds](../boards.md).", "boards"
        ),
        "sensing": group_page("Sensing", "`sensing=<name>` chooses the sensors' errors and the delays.", "sensing"),
        "randomization": group_page(
            "Randomization",
            "`randomization=<name>` chooses the ranges of masses, friction and motors, and the pushes.",
            "randomization",
        ),
        "tasks": tasks_page(),
        "stages": stages_page(),
        "suites": suites_page(),
        "policies": policies_page(),
        "classes": classes_page(),
    }
    return {name: (text.splitlines()[0].lstrip("# "), text) for name, text in made.items()}


def write(folder: Path, write_if_changed: Any) -> list[str]:
    """Write every page and return their names.

    Args:
        folder: Where to.
        write_if_changed: Takes a path and a text.
    """
    made = pages()
    for name, (_, text) in made.items():
        write_if_changed(folder / f"{name}.md", text.rstrip() + "\n")
    return list(made)
