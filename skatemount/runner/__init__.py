"""Use of an exported policy with numpy, onnxruntime and mujoco alone: checks, MountBench in MuJoCo, and a real robot.

`skatemount.runner.folder.PolicyFolder` reads what `python -m skatemount.export` wrote,
`skatemount.runner.controller.Controller` turns measurements into joint targets,
`skatemount.runner.simulation.SimulatedWorld` runs the shipped episodes, and `skatemount.runner.hardware.run` drives a
robot within its limits. Nothing here imports torch or the rest of the package.
"""

from skatemount.runner.program import main

__all__ = ["main"]
