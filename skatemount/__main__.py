"""`skatemount <program> ...` and `python -m skatemount <program> ...`: every program in one command."""

from __future__ import annotations

import importlib
import os
import sys

from skatemount.utils.terminal import safe_streams

PROGRAMS = {
    "train": ("stage=balance", "train a stage (without one: which there are)"),
    "evaluate": ("checkpoint=pretrained:balance", "how often a policy succeeds"),
    "record": ("checkpoint=pretrained:balance", "film it"),
    "play": ("checkpoint=pretrained:anywhere", "watch and push it in a browser"),
    "report": ("run=latest output=report.html", "a page about a run, two runs, a sweep or the paper"),
    "export": ("checkpoint=pretrained:balance", "write it as ONNX, for a robot"),
    "bench": ("stage=balance", "how fast training is here"),
    "search": ("stage=balance search=ppo", "search good settings of a training"),
    "runner": ("exported/balance suite=balance-fixed", "use what export wrote, without torch"),
    "list": ("stages", "stages, suites, boards, policies, terms, ..."),
    "replay-diverged": ("runs/.../0001_world_7.npz", "why the physics of a world failed"),
    "robot-spec": ("robot.urdf", "a robot of your own from its URDF or MJCF"),
}
"""Arguments of an example and a description for each program."""


def help_text() -> str:
    """Return what programs there are."""
    lines = ["skatemount is used through its programs:"]
    for name, (example, about) in PROGRAMS.items():
        lines.append(f"  {f'skatemount {name} {example}':52}{about}")
    lines.append("python -m skatemount <program> is the same. Those up to search are modules too, such as python -m")
    lines.append("skatemount.train; their option --cfg job prints all settings.")
    return "\n".join(lines)


@safe_streams()
def main() -> None:
    """Run the program that the first argument names, with the rest of the command line."""
    # A script lies in another folder; with `python -m`, modules of the working directory can be imported.
    if os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    name = sys.argv[1] if len(sys.argv) > 1 else "--help"
    if name in ("--help", "-h"):
        print(help_text())
        return
    if name not in PROGRAMS:
        print(f"skatemount: there is no program {name}; there are: {', '.join(PROGRAMS)}", file=sys.stderr)
        sys.exit(2)
    sys.argv = [f"{sys.argv[0]} {name}", *sys.argv[2:]]
    module = "listing" if name == "list" else name.replace("-", "_")
    importlib.import_module(f"skatemount.{module}").main()


if __name__ == "__main__":
    main()
