"""Write a results file of MountBench and put its numbers into the README and the docs.

    python tools/write_results.py anywhere checkpoint=pretrained:anywhere suite=all episodes=2000
    python tools/write_results.py anywhere --evaluated result.json --commit 8399278
    python tools/write_results.py --fill
    python tools/write_results.py --ladders docs/_static/ladders.png robust anywhere

The first form runs `python -m skatemount.evaluate` with the given settings and writes `docs/results/anywhere.json`. The
second form takes the file of an evaluation that has already run. Both then fill the pages; the third form only fills
them. The fourth form draws the ladders of several results files: a panel for each suite, a line for each file.

A page names a number where it stands, in comments that Markdown does not show:

    The robot mounts in <!-- result anywhere/approach-unfixed/success -->98.7 %<!-- end --> of the episodes.

Everything between the two comments is replaced. `VALUES` and `BLOCKS` list what can be named;
`robust+anywhere/compared` names a table of two files side by side.
"""

from __future__ import annotations

import argparse
import json
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "docs" / "results"
FORMAT = 1
MARK = re.compile(r"<!-- result (\S+) -->(.*?)<!-- end -->", re.DOTALL)

SUMMARY = ("approach-unfixed", "mount-unfixed", "rolling", "low-friction", "other-boards", "far", "pushed")
"""Suites in the short table of the README: the free board, from easy to hard."""

SHORT = {
    "approach-unfixed": "0.5 to 1.0 m beside the board, any heading",
    "mount-unfixed": "in a 60 × 60 cm square around the board, any heading",
    "rolling": "beside a board that already rolls at up to 0.5 m/s",
    "low-friction": "beside the board, friction at 0.4 to 0.6 of nominal",
    "other-boards": "beside one of ten boards that training did not have",
    "far": "1 to 2 m away; training never went beyond 1.05 m",
    "pushed": "beside the board, with pushes of up to 0.25, 0.5, or 0.75 m/s; training had none",
}
"""The start of each of these suites in a few words."""


def percent(share: float) -> str:
    """Return a share as a percentage with one decimal."""
    return f"{100 * share:.1f} %"


def interval(suite: dict[str, Any]) -> str:
    """Return Wilson's 95 % interval of a suite's success rate."""
    return f"{100 * suite['success']['low']:.1f} to {percent(suite['success']['high'])}"


def failures(suite: dict[str, Any]) -> str:
    """Return what ended the failed episodes, with counts, the most frequent first."""
    return ", ".join(f"{_in_words(name)} {count}" for name, count in suite["failures"].items()) or "none"


def _in_words(end: str) -> str:
    """Return the name of an episode's end in the words of `python -m skatemount.evaluate`."""
    # Imported only here because it needs torch.
    from skatemount.envs.tasks import TASKS
    from skatemount.evaluation.results import in_words

    tasks = [TASKS.get(name) for name in TASKS.names()]
    return in_words(end, next((task for task in tasks if task.failure == end), tasks[0]))


def time_to_mount(suite: dict[str, Any]) -> str:
    """Return the median time to mount."""
    median = suite["time_to_mount"]["median"]
    return "–" if median is None else f"{median:.2f} s"


VALUES: dict[str, Callable[[dict[str, Any]], str]] = {
    "success": lambda suite: percent(suite["success"]["rate"]),
    "interval": interval,
    "feet": lambda suite: f"{suite['feet_on_board']:.2f}",
    "time": time_to_mount,
    "failures": failures,
    "episodes": lambda suite: f"{suite['episodes']:,}",
}
"""Numbers of one suite: ``<file>/<suite>/<value>``, or ``<file>/<suite>/<variant>/<value>``."""


def provenance(results: dict[str, Any]) -> str:
    """Return where the numbers come from, in one sentence."""
    return (
        f"skatemount {results['versions']['skatemount']}, commit `{results['commit']}`, seed {results['seed']}, "
        f"MuJoCo {results['versions']['mujoco']}, PyTorch {results['versions']['torch']}"
    )


def command(results: dict[str, Any]) -> str:
    """Return the command as a block, with today's names of shipped policies."""
    from skatemount.runs.shipped import ALIASES, PRETRAINED

    words = results["command"]
    for old, new in ALIASES.items():
        words = re.sub(rf"={PRETRAINED}{old}(?=\s|$)", f"={PRETRAINED}{new}", words)
    return f"\n```console\n$ {words}\n```\n"


def table(results: dict[str, Any]) -> str:
    """Return a row for each suite; one of another task than to mount a board has no time to mount and no feet."""
    rows = [
        "| suite | success | 95 % interval | time to mount | feet on board | failures |",
        "|---|---|---|---|---|---|",
    ]
    for name, suite in results["suites"].items():
        mounts = suite["stage"] != "gait" and "time_to_mount" in suite
        time, feet = (time_to_mount(suite), f"{suite['feet_on_board']:.2f}") if mounts else ("–", "–")
        rows.append(
            f"| `{name}` | {percent(suite['success']['rate'])} | {interval(suite)} | {time} | {feet} "
            f"| {failures(suite)} |"
        )
    return "\n".join(["", *rows, ""])


def summary(results: dict[str, Any]) -> str:
    """Return the short table of the README."""
    rows = ["| suite | the robot starts | success | 95 % interval |", "|---|---|---|---|"]
    for name in SUMMARY:
        suite = results["suites"][name]
        rows.append(f"| `{name}` | {SHORT[name]} | {percent(suite['success']['rate'])} | {interval(suite)} |")
    return "\n".join(["", *rows, ""])


def variants(results: dict[str, Any], suite: str = "other-boards") -> str:
    """Return a row for each variant of a suite."""
    rows = ["| board | success | 95 % interval |", "|---|---|---|"]
    for name, part in results["suites"][suite]["variants"].items():
        rows.append(f"| {name} | {percent(part['success']['rate'])} | {interval(part)} |")
    return "\n".join(["", *rows, ""])


def faults(results: dict[str, Any]) -> str:
    """Return the table of faults that `benchmarks/faults.py` tried."""
    lines = ["", "| fault | times tried | lost |", "|---|---|---|"]
    for row in (row for rows in results["faults"].values() for row in rows):
        most, mean = row["iterations_lost_most"], row["iterations_lost_mean"]
        lost = f"at most {most} iteration{'s' * (most > 1)}, {mean:.2f} on average" if most else row["lost"]
        named = f"; said: `{row['named']}`" if "named" in row else ""
        kinds = f" of {row['kinds']} kinds" if "kinds" in row else ""
        lines.append(f"| {row['fault']} | {row['times']:,}{kinds} | {lost}{named} |")
    return "\n".join([*lines, "", ""])


def memory(results: dict[str, Any]) -> str:
    """Return the table of threads, open files and memory that `benchmarks/leaks.py` saw."""
    lines = ["", "| after | threads | open files | memory |", "|---|---|---|---|"]
    for row in results["memory"]["environments"] + results["memory"]["training"]:
        built = row.get("environments")
        label = f"{row.get('iterations', 0):,} iterations, {row.get('seconds', 0)} s" if built is None else built
        after = f"training: {label}" if built is None else f"{label} environments closed"
        lines.append(f"| {after} | {row['threads']:.0f} | {row['files']:.0f} | {row['memory_mib']:.0f} MiB |")
    return "\n".join([*lines, "", ""])


def growth(results: dict[str, Any]) -> str:
    """Return the memory that a closed environment keeps while it is referenced."""
    first, *_, last = results["memory"]["environments"]
    more = last["memory_mib"] - first["memory_mib"]
    return f"{1024 * more / (last['environments'] - first['environments']):.0f} KiB"


def curves(results: dict[str, Any]) -> str:
    """Return the table of what the trainings of `benchmarks/rsl_rl_curves.py` reached, a row for each seed."""
    lines = ["", "| PPO | seed | steps | success | processor time |", "|---|---|---|---|---|"]
    for name, seeds in results["curves"].items():
        for seed, points in seeds.items():
            last = points[-1]
            minutes = f"{last['cpu_seconds'] / 60:.1f} min"
            lines.append(f"| {name} | {seed} | {last['frames']:,} | {percent(last['success'])} | {minutes} |")
    return "\n".join([*lines, "", ""])


def compared(*files: dict[str, Any]) -> str:
    """Return the success rates of several files side by side, with a row for each suite and each step of a ladder.

    A suite of other variants has a row for all of them and one for the worst of each file.

    Raises:
        ValueError: The files have results of different versions of a suite.
    """
    names = [results["checkpoint"].removeprefix("pretrained:") for results in files]
    rows = [f"| suite | variant | {' | '.join(names)} |", "|---|---" + "|---" * len(files) + "|"]
    for suite in dict.fromkeys(suite for results in files for suite in results["suites"]):
        found = [results["suites"].get(suite) for results in files]
        known = [each for each in found if each is not None]
        if len(versions := sorted({each["version"] for each in known})) > 1:
            raise ValueError(f"{suite}: {' and '.join(names)} have results of its versions {versions}, which differ")
        first = known[0]
        if "ladder" in first:
            steps = first["variants"]
            cells = {step: [each and rate(each["variants"][step]) for each in found] for step in steps}
        else:
            cells = {"": [each and rate(each) for each in found]}
            if "variants" in first:
                cells["the worst one"] = [each and _worst(each["variants"]) for each in found]
        rows += [f"| `{suite}` | {step} | {' | '.join(c or '–' for c in row)} |" for step, row in cells.items()]
    return "\n".join(["", *rows, ""])


def rate(suite: dict[str, Any]) -> str:
    """Return a success rate with its interval."""
    return f"{percent(suite['success']['rate'])} ({interval(suite)})"


def _worst(variants: dict[str, Any]) -> str:
    name = min(variants, key=lambda each: variants[each]["success"]["rate"])
    return f"{rate(variants[name])}, {name}"


BLOCKS: dict[str, Callable[[dict[str, Any]], str]] = {
    "provenance": provenance,
    "command": command,
    "table": table,
    "summary": summary,
    "boards": variants,
    "curves": curves,
    "faults": faults,
    "memory": memory,
    "growth": growth,
}
"""Parts of one file: ``<file>/<part>``. A table of several files is ``<file>+<file>/compared``."""


def condensed(evaluation: dict[str, Any], commit: str) -> dict[str, Any]:
    """Return what the pages need of an evaluation, with everything that repeating it takes.

    Args:
        evaluation: The document that ``json=`` of `python -m skatemount.evaluate` wrote.
        commit: Git commit of the code that evaluated.
    """
    suites = evaluation.get("suites") or {evaluation["evaluated"]["suite"]: evaluation}
    first = next(iter(suites.values()))
    about = first["evaluated"]
    name = next(iter(suites)) if len(suites) == 1 else "all"
    # The command that films an episode names the policy and the settings as the user gave them.
    given = [word for word in shlex.split(about["record"])[3:] if word.split("=")[0] not in ("suite", "episode")]
    words = [
        "python",
        "-m",
        "skatemount.evaluate",
        given[0],
        f"suite={name}",
        f"episodes={first['episodes']}",
        *given[1:],
    ]
    return {
        "format": FORMAT,
        "command": shlex.join(words),
        "checkpoint": given[0].partition("=")[2],
        "sha256": about["sha256"],
        "commit": commit,
        "seed": about["seed"],
        "versions": about["versions"],
        "suites": {name: _suite(suite) for name, suite in suites.items()},
    }


def _suite(document: dict[str, Any]) -> dict[str, Any]:
    definition = document["evaluated"]["definition"]
    about = {key: definition[key] for key in ("version", "stage", "description")}
    drop = ("failed_episodes", "evaluated")
    return about | {key: value for key, value in document.items() if key not in drop}


def read(name: str) -> dict[str, Any]:
    """Return a results file's content."""
    results: dict[str, Any] = json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))
    return results


def draw_ladders(names: list[str], png_path: Path) -> None:
    """Draw the ladders of results files, with a panel for each suite and a line for each file.

    Raises:
        ValueError: A file has no ladder.
    """
    from skatemount.evaluation.ladder import Ladder, plot_ladders

    found: dict[str, dict[str, Ladder]] = {}
    for name in names:
        ladders = {suite: each["ladder"] for suite, each in read(name)["suites"].items() if "ladder" in each}
        if not ladders:
            raise ValueError(f"{name}.json has no ladder; evaluate suite=delay, board-bias, pushed or low-friction")
        for suite, values in ladders.items():
            found.setdefault(suite, {})[name] = Ladder.from_dict(values)
    plot_ladders(found, png_path)


def look_up(key: str) -> str:
    """Return what a page's comment names.

    Raises:
        KeyError: No results file, suite or value has that name.
    """
    name, *path = key.split("/")
    if path == ["compared"]:
        return compared(*map(read, name.split("+")))
    results = read(name)
    if len(path) == 1:
        return BLOCKS[path[0]](results)
    suite, *variant, value = path
    part = results["suites"][suite]
    return VALUES[value](part["variants"][variant[0]] if variant else part)


def pages() -> Iterator[Path]:
    """Yield the README and every page of the docs."""
    yield ROOT / "README.md"
    for path in sorted((ROOT / "docs").rglob("*.md")):
        if not {"_build", "api"} & set(path.parts):
            yield path


def filled(text: str) -> str:
    """Return a page's text with every named number put in."""
    return MARK.sub(lambda match: f"<!-- result {match[1]} -->{look_up(match[1])}<!-- end -->", text)


def fill() -> None:
    """Put the numbers into the pages and name those that changed."""
    for path in pages():
        text = path.read_text(encoding="utf-8")
        if (new := filled(text)) != text:
            path.write_text(new, encoding="utf-8")
            print(path.relative_to(ROOT))


def _commit() -> str:
    def git(*words: str) -> str:
        return subprocess.run(["git", *words], cwd=ROOT, check=True, capture_output=True, text=True).stdout.strip()

    changed = git("status", "--porcelain", "--", "skatemount", "conf")
    return git("rev-parse", "--short=7", "HEAD") + ("-dirty" if changed else "")


def _evaluate(settings: list[str]) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "evaluation.json"
        subprocess.run([sys.executable, "-m", "skatemount.evaluate", *settings, f"json={file}"], cwd=ROOT, check=True)
        found: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return found


def main() -> None:
    """Evaluate if asked to, write the file, fill the pages."""
    parser = argparse.ArgumentParser(
        description=__doc__.splitlines()[0], epilog=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("name", nargs="?", help="of the results file, without .json")
    parser.add_argument("settings", nargs="*", help="settings of the evaluation, such as checkpoint=latest")
    parser.add_argument("--evaluated", type=Path, help="JSON of an evaluation that has already run")
    parser.add_argument("--commit", help="git commit that evaluated; the working tree's if not given")
    parser.add_argument("--fill", action="store_true", help="only put the numbers into the pages")
    parser.add_argument("--ladders", type=Path, metavar="PNG", help="draw the ladders of the results files named")
    options = parser.parse_args()
    if options.ladders is not None and options.name is not None:
        draw_ladders([options.name, *options.settings], options.ladders)
        return
    if options.fill == (options.name is not None):
        parser.error("give the name of a results file, or --fill alone; --ladders needs names, too")
    if options.name is not None:
        commit = options.commit or _commit()
        if options.evaluated is None:
            evaluation = _evaluate(options.settings)
        else:
            evaluation = json.loads(options.evaluated.read_text(encoding="utf-8"))
        RESULTS.mkdir(exist_ok=True)
        file = RESULTS / f"{options.name}.json"
        file.write_text(json.dumps(condensed(evaluation, commit), indent=2) + "\n", encoding="utf-8")
        print(file.relative_to(ROOT))
    fill()


if __name__ == "__main__":
    main()
