"""Search of good settings: trials of a training that several processes share, with Optuna."""
