"""Run folders: checkpoints, metrics and where they came from."""
