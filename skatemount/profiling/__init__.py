"""How fast a training is, and what limits it."""
