"""`python -m skatemount.runner <folder>`: check an exported policy, and run MountBench with it in plain MuJoCo."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

HELP = """\
Use a policy that python -m skatemount.export wrote, with numpy, onnxruntime and mujoco alone.

  python -m skatemount.runner FOLDER
  python -m skatemount.runner FOLDER suite=approach-unfixed episodes=500 json=result.json
  python -m skatemount.runner FOLDER suite=all

FOLDER           the folder of the policy
suite=           a suite whose start states are in the folder, or all; without one, only the check
episodes=        of each suite; without it, all start states of the folder
seed=            of the noise of sensors and observation (0)
json=            file for the results, as that of skatemount.evaluate

The test vectors of the folder are checked first. episodes=, seed=, and json= are for a suite.
skatemount.runner.hardware.run drives a real robot."""

_KEYS = ("suite", "episodes", "seed", "json")


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the program; a mistake ends it with one line and status 2."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if not given or {"--help", "-h"} & set(given):
        print(HELP)
        return
    from skatemount.runner.folder import RunnerError

    try:
        _run(given)
    except (RunnerError, OSError) as error:
        print(f"skatemount.runner: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("skatemount.runner: ended by SIGINT", file=sys.stderr)
        sys.exit(130)


def _run(arguments: list[str]) -> None:
    from skatemount.runner.folder import PolicyFolder, RunnerError

    path, settings = _read(arguments)
    folder = PolicyFolder(path)
    card = folder.card
    differences = folder.check()
    policy, rate = card["policy"], f"{card['control']['rate_hz']:g} actions a second"
    print(f"{policy['name']} ({policy['stage']}), robot {card['robot']['name']}, {rate}")
    largest = ", ".join(f"{name} {value:.1g}" for name, value in differences.items())
    print(f"test vectors: equal; largest differences: {largest}")
    chosen = settings.get("suite")
    names = list(folder.suites) if chosen == "all" else [chosen] if chosen else []
    if chosen and not names:
        raise RunnerError("suite=all: the folder has no start states; export with suite=all and episodes=500")
    if not names:
        print(f"suites: {', '.join(folder.suites) or 'none'}")
        return
    _check_imports()
    if "json" in settings:
        if Path(settings["json"]).is_dir():
            raise RunnerError(f"json={settings['json']} is a folder; it must name a file")
        Path(settings["json"]).parent.mkdir(parents=True, exist_ok=True)
    from skatemount.runner import bench

    seed = settings.get("seed", 0)
    documents = {}
    for name in names:
        results = bench.run_suite(folder, name, settings.get("episodes"), seed, _Progress(name))
        made = documents[name] = bench.document(folder, name, results, seed)
        success, failures = made["success"], made["failures"]
        changes = made["evaluated"]["changed_by"]
        changed = f", changed by {', '.join(changes)}" if changes else ""
        words = bench.end_words(folder, name)
        causes = ", ".join(f"{words.get(cause, cause)} {count}" for cause, count in failures.items()) or "none"
        print(
            f"{name}{changed}: success {success['rate']:.1%} of {made['episodes']} episodes (95 % interval "
            f"{success['low']:.1%} to {success['high']:.1%}), failures: {causes}",
            flush=True,
        )
    if "json" in settings:
        content: Any = {"suites": documents} if len(names) > 1 else documents[names[0]]
        Path(settings["json"]).write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")
        print(f"written to {settings['json']}")


def _read(arguments: list[str]) -> tuple[str, dict[str, Any]]:
    """Return the folder and the settings of a command line.

    Raises:
        RunnerError: A setting is unknown, is there twice, has a value that cannot be used, or needs ``suite=``.
    """
    from skatemount.runner.folder import RunnerError

    folders = [each for each in arguments if "=" not in each]
    if len(folders) != 1 or folders[0].startswith("-"):
        found = " ".join(folders) or "nothing"
        raise RunnerError(f"give one folder of an exported policy, not {found}; --help shows the settings")
    settings: dict[str, Any] = {}
    written: dict[str, str] = {}
    for each in arguments:
        key, equals, value = each.partition("=")
        if not equals:
            continue
        if key not in _KEYS:
            raise RunnerError(f"{key} is not a setting; known: {', '.join(_KEYS)}")
        if key in written:
            raise RunnerError(f"{each} with {written[key]}: give each setting once")
        written[key] = each
        if not value:
            raise RunnerError(f"{key}= has no value; leave it out, or give one")
        if key in ("episodes", "seed"):
            least = 1 if key == "episodes" else 0
            if not value.isdecimal() or int(value) < least:
                raise RunnerError(f"{key}={value} must be a whole number, {least} or more")
            settings[key] = int(value)
        else:
            settings[key] = value
    if written and "suite" not in written:
        first = next(iter(written.values()))
        raise RunnerError(f"{first} needs suite=<name>, or suite=all: without one, only the check runs")
    return folders[0], settings


def _check_imports() -> None:
    """Raise `RunnerError` if mujoco is missing."""
    from importlib.util import find_spec

    from skatemount.runner.folder import RunnerError

    if find_spec("mujoco") is None:
        raise RunnerError("suite= needs the package mujoco: pip install mujoco")


class _Progress:
    """Progress on a terminal, in one line."""

    def __init__(self, name: str):
        self._name, self._shown = name, sys.stderr.isatty()

    def __call__(self, done: int, total: int) -> None:
        if self._shown:
            end = "\r" if done < total else "\r\033[K"
            print(f"{self._name}: {done} of {total} episodes", end=end, file=sys.stderr, flush=True)
